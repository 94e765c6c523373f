"""Fuzz test: calls of public functions with odd arguments must work or raise a clear one-line error.

`PYTHONPATH=tests python -m oracles.fuzz 50000` makes 50000 calls and prints the findings with their seeds;
`PYTHONPATH=tests python -m oracles.fuzz 1 17 Scene` repeats the call with seed 17 of the target Scene.
"""

import resource
import signal
import sys
import time
import warnings
from collections import Counter
from contextlib import contextmanager

import numpy as np

import flexman_gym as fm

from oracles.fuzz_targets import TARGETS
from oracles.odd_values import NO_NUMBERS, fits, odd

LONGEST = 10  # s that a call may take
MEMORY = 6 * 2**30  # bytes that a process of calls may have
KEYWORDS = ("unexpected keyword argument", "required positional argument", "keywords must be strings",
            "multiple values for")  # fmt: skip


class TooLong(BaseException):
    """Raised for a call that hangs."""


@contextmanager
def bounded(seconds=None):
    """Abort a call that takes too long."""

    def ring(number, frame):
        raise TooLong

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds or LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def arguments(seed, name=None):
    """Return target, arguments and odd arguments of the call with a seed."""
    random = np.random.default_rng(seed)
    names = list(TARGETS)
    weights = np.array([TARGETS[each].weight for each in names])
    drawn = names[random.choice(len(names), p=weights / weights.sum())]
    name = name or drawn
    good = TARGETS[name].good
    count = min(len(good), 1 + int(random.integers(4) == 0) + int(random.integers(12) == 0))
    chosen = random.choice(len(good), count, replace=False)
    strange = {list(good)[i]: odd(random, list(good.values())[i]) for i in chosen}
    return name, {**good, **strange}, strange


def too_much(target, strange):
    """Return whether an allowed argument would take long."""
    for name, most in target.cost.items():
        value = strange.get(name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                if np.max(np.abs(np.asarray(value, dtype=float))) > most:
                    return True
            except Exception:
                continue
    return False


def numbers_in(value, seen=0):
    """Yield the numerical arrays in the result of a call."""
    if isinstance(value, fm.Trajectory):
        yield from (value.states, value.tip, value.energy, value.energy_residual)
    elif isinstance(value, fm.Model):
        yield from (each for each in value.constants if each.dtype.kind == "f")
    elif isinstance(value, fm.Simulator):
        yield from (value.state, value.outputs)
    elif isinstance(value, np.ndarray):
        if value.dtype.kind in "fc":
            yield value
    elif isinstance(value, float | complex | np.floating):
        yield np.array(value)
    elif isinstance(value, dict) and seen < 4:
        for each in value.values():
            yield from numbers_in(each, seen + 1)
    elif isinstance(value, list | tuple) and seen < 4:
        for each in value:
            yield from numbers_in(each, seen + 1)


def implausible(target, result, strange):
    """Return the defect of the result of a call; "" if there is none."""
    for name in target.numbers:
        if any(strange.get(name) is each for each in NO_NUMBERS):
            return f"took {name} = {type(strange[name]).__name__}, which is no number"
    if not target.open_to:
        for values in numbers_in(result):
            if not np.isfinite(values).all():
                return "gave what is not finite"
    for each in result if isinstance(result, list | tuple) else [result]:
        if isinstance(each, fm.Trajectory) and each.status != "ok" and not each.explanation():
            return f"{each.status} without an explanation"
    return ""


def outcome(target, given, strange):
    """("works" or "refused", "") of a call, or ("finding", what was wrong)."""
    started = time.process_time()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            with bounded():
                wrong = implausible(target, target.call(**given), strange)
        except ValueError as error:
            wrong = loud(said) or ("" if fits(str(error)) else f"ValueError: {error}")
            return ("finding", wrong) if wrong else ("refused", "")
        except (FileNotFoundError, RuntimeError, TypeError) as error:
            words = KEYWORDS if isinstance(error, TypeError) else ("; give ", "reset it first", "reset the environment")
            good = any(word in str(error) for word in words) and len(str(error)) < 400
            return ("refused", "") if good else ("finding", f"{type(error).__name__}: {error}")
        except TooLong:
            return "finding", f"took more than {LONGEST} s"
        except Exception as error:
            return "finding", f"{type(error).__name__}: {error}"
    wrong = wrong or loud(said)
    if time.process_time() - started > LONGEST:
        wrong = wrong or f"took {time.process_time() - started:.0f} s"
    return ("finding", wrong) if wrong else ("works", "")


def loud(said):
    """Return the first numerical warning, "" without one; warnings of the package itself are intended."""
    for each in said:
        if not issubclass(each.category, UserWarning) or issubclass(each.category, np.exceptions.ComplexWarning):
            return f"{each.category.__name__}: {each.message}"
    return ""


def described(strange):
    """Return the odd arguments as one line."""
    from flexman_gym.common.errors import short_repr

    return ", ".join(f"{name}={short_repr(value)} ({type(value).__name__})" for name, value in strange.items())


def run(count, first=0, name=None):
    """Make calls from a seed on; return outcome counts and findings (seed, target, defect, arguments)."""
    outcomes, findings = Counter(), []
    for seed in range(first, first + count):
        chosen, given, strange = arguments(seed, name)
        if too_much(TARGETS[chosen], strange):
            outcomes["too much"] += 1
            continue
        kind, what = outcome(TARGETS[chosen], given, strange)
        outcomes[kind] += 1
        if kind == "finding":
            findings.append((seed, chosen, what, described(strange)))
    return outcomes, findings


def main(words):
    """Make the calls requested on the command line."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    count, first = int(words[0]), int(words[1]) if len(words) > 1 else 0
    total = Counter()
    for target in TARGETS.values():  # which compiles what they need
        target.call(**target.good)
    for seed in range(first, first + count):
        outcomes, findings = run(1, seed, *words[2:3])
        total += outcomes
        for row in findings:
            print(" | ".join(map(str, row))[:600].replace("\n", "\\n"), flush=True)
    print(dict(total))


if __name__ == "__main__":
    main(sys.argv[1:])
