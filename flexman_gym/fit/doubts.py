"""Doubts: what the data cannot tell, and what looks wrong with them."""

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.fit.free import Free
from flexman_gym.fit.measurement import unit_of
from flexman_gym.fit.problem import Part, Problem

LIMIT, INVOLVED = 0.5, 0.3  # of a number: a deviation that tells nothing; of a direction: a part that counts
LOUD, ALIKE, CLEAN = 10.0, 0.7, 0.995  # usual errors; least correlation of a scale; R2 at which no filter is looked for
SCALES = {"rad": {57.29578: "deg", 1e3: "mrad"}, "m": {1e3: "mm", 1e2: "cm"}, "m/s^2": {1.0 / 9.80665: "g"},
          "1": {1e6: "um/m", 1e2: "percent"}}  # fmt: skip
SCALE = 4.0  # times, from which on a scale is odd
FILTERED = 0.5  # of the squared residuals, that a filter leaves which is missing


def untold(free: Free, values: Array, covariance: Array) -> tuple[tuple[str, ...], str]:
    """Gives the numbers that the data cannot tell, and one sentence about them.

    A number cannot be told where its standard deviation is more than half of it, and of what the fit started from.

    Args:
        free: what is free.
        values: (p,).
        covariance: (p, p) of their logarithms.
    """
    scale = values / np.maximum(values, free.start)
    sizes, directions = np.linalg.eigh(covariance * np.outer(scale, scale))
    wide = np.sqrt(np.diag(covariance)) * scale > LIMIT
    names = tuple(str(number) for number, each in zip(free.numbers, wide, strict=True) if each)
    said, alone = [], set(names)
    for size, direction in sorted(zip(sizes, directions.T, strict=True), key=lambda pair: -pair[0]):
        together = [str(free.numbers[i]) for i in np.flatnonzero(wide & (np.abs(direction) > INVOLVED))]
        if np.sqrt(max(size, 0.0)) > LIMIT and len(together) > 1 and alone & set(together):
            said.append(f"{' and '.join(together)} apart")
            alone -= set(together)
    said = [*(name for name in names if name in alone), *said]
    return names, f"The data cannot tell {', nor '.join(said)}." if said else "The data tell every free number."


def doubts(problem: Problem, x: Array) -> tuple[str, ...]:
    """Gives a line for each thing that looks wrong with the records."""
    said = []
    first = problem.divided(problem.evaluated(problem.start)[0])
    last = problem.divided(problem.evaluated(x)[0])
    muddy = set()
    for part, before, after in zip(problem.parts, first, last, strict=True):
        if part.record < 0:
            continue
        where, left = f"record {part.record}, {part.name}", after * part.sigma
        said += _spikes(where, problem, part, left)
        odd = _scale(where, part, part.measured + before * part.sigma) if part.gain < 0 else ""
        said += [odd] if odd else []
        score = 1.0 - np.mean(left**2) / max(float(np.var(part.measured)), 1e-300)
        if score < CLEAN and not odd and not problem.responses[part.record].measurement.filters.get(part.name):
            muddy.add(part.name)
        if score < 0.5:
            said.append(
                f"{where}: the arm explains {max(score, 0.0):.0%} of it; the model or the record lacks something"
            )
    return (*said, *(line for name in sorted(muddy) for line in _filter(problem, x, name)))


def _spikes(where: str, problem: Problem, part: Part, left: Array) -> list[str]:
    """Samples far beyond their neighbours."""
    jumps = np.abs(left[1:-1] - 0.5 * (left[2:] + left[:-2]))
    loud, beside = LOUD * max(1.4826 * float(np.median(jumps)), 1e-9 * np.ptp(part.measured)), np.pad(jumps, 1)
    found = np.flatnonzero((jumps > loud) & (jumps >= beside[:-2]) & (jumps >= beside[2:])) + 1
    if not len(found) or len(found) > 0.02 * len(left):
        return []
    data = problem.responses[part.record].measurement
    time = np.asarray(data.times)[data.compared][found[0]]
    return [f"{where}: single samples stand out of what is left, the first at {time:g} s; is the record damaged?"]


def _scale(where: str, part: Part, shown: Array) -> str:
    """A unit or a sign that looks wrong beside the arm as it was given."""
    a, b = shown - shown.mean(), part.measured - part.measured.mean()
    sizes = np.linalg.norm(a), np.linalg.norm(b)
    if min(sizes) == 0.0:
        return ""
    alike, ratio = float(a @ b) / (sizes[0] * sizes[1]), float(sizes[1] / sizes[0])
    if alike < -ALIKE:
        return f"{where}: it moves against the arm; is a sign wrong?"
    if alike < ALIKE or 1.0 / SCALE < ratio < SCALE:
        return ""
    unit = unit_of(part.name)
    near = [name for factor, name in SCALES.get(unit, {}).items() if 0.5 < ratio / factor < 2.0]
    other = f" in {near[0]}" if near else " or an input in another unit"
    return f"{where}: it is {ratio:.3g} times what the arm shows in {unit}; is it{other}?"


def _filter(problem: Problem, x: Array, name: str) -> list[str]:
    """A low-pass that the record does not name, where one explains most of what is left."""
    other = Problem(problem.free, problem.ringing, problem.responses, problem.choice, corner=name)
    start = other.start.copy()
    at = len(problem.free.numbers) + other.nuisances.index(f"corner of {name}")
    data = other.responses[0].measurement
    start[at] = np.log(2.0 * np.pi / data.period * np.sqrt(0.5 / len(data.times)))  # between slowest and fastest
    found = other.solved(start)
    left = [_left(each, y, name) for each, y in ((problem, x), (other, found))]
    corner = float(np.exp(found[at]) / (2.0 * np.pi))
    if left[1] > FILTERED * left[0] or corner > 0.4 / data.period:
        return []
    return [f"{name}: a low-pass of about {corner:.2g} Hz, which the record does not name, explains it better; "
            f"did the signal pass one?"]  # fmt: skip


def _left(problem: Problem, x: Array, name: str) -> float:
    """Squared residuals of an output in all records."""
    parts = zip(problem.parts, problem.divided(problem.evaluated(x)[0]), strict=True)
    return float(sum(np.sum((rows * part.sigma) ** 2) for part, rows in parts if part.name == name))
