"""Page of the comparison of algorithms at equal CPU time."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.common.formatting import millimetres
from flexman_gym.common.markdown import markdown_table
from flexman_gym.evaluation.shares import share_text
from flexman_gym.metrics.statistics import median_interval
from studies.learning.algorithms import BUDGETS, ENVIRONMENT, EPISODES, RECIPES, REFERENCES, STEPS, AlgorithmRow
from studies.screen import screen

TITLES = {"sac": "SAC", "tqc": "TQC", "crossq": "CrossQ", "ppo": "PPO"}
QUESTION = "Which algorithm trains the best policy in the same CPU time, and where does training not pay?"
ANSWER = "**{best}** {references}"
BODY = """{table}

Slews of `{environment}`, episodes {first} to {final}: settled share, median settling time, 95 %
intervals (Wilson; bootstrap over episodes and training seeds, with one seed without the spread between runs). Policies
add torques to the PD and observe the true state, as `lqr-tracking` does; `shaping-flexrrr`, a policy on such a
controller, and `planned` also have the parameters.

CPU time of one core. A run ends with its schedules or after {last:g} minutes{ends}. Schedules that end earlier
make earlier policies better."""


class _Result(NamedTuple):
    """Result after a CPU time: settled share, median time (s) with interval, vibration (m), seeds, episodes of each."""

    settled: float
    time: float
    low: float
    high: float
    vibration: float
    seeds: int
    episodes: int

    @property
    def short(self) -> str:
        """Settled share and median settling time."""
        return f"{100 * self.settled:.0f} %" + (f", {self.time:.2f} s" if math.isfinite(self.time) else "")

    @property
    def text(self) -> str:
        """Settled share and median settling time, with their intervals."""
        time = f", {self.time:.2f} s ({_seconds(self.low)} to {_seconds(self.high)})"
        return share_text(self.settled, self.episodes) + time * math.isfinite(self.time)


def result(rows: Iterable[AlgorithmRow], algorithm: str, minutes: float | None) -> _Result | None:
    """Return the result of an algorithm after a CPU time (min) over all seeds; None without rows."""
    found = [row for row in rows if (row.algorithm, row.minutes) == (algorithm, minutes)]
    if not found:
        return None
    times = median_interval(np.array([row.settling_times for row in found]))
    settled, vibration = (float(np.median([getattr(row, name) for row in found])) for name in ("settled", "vibration"))
    return _Result(settled, *times, vibration, len(found), len(found[0].settling_times))


def best(rows: Sequence[AlgorithmRow], minutes: float) -> list[tuple[str, _Result]]:
    """Return the algorithms with their results after a CPU time (min), the shortest median settling time first."""
    found = [(name, each) for name in RECIPES if (each := result(rows, name, minutes))]
    return sorted(found, key=lambda pair: (pair[1].time, -pair[1].settled))


def comparison(rows: Sequence[AlgorithmRow]) -> str:
    """Return a sentence with the fastest policy and the next after each CPU time."""
    parts, seeds = [], []
    for minutes in BUDGETS:
        if len(order := best(rows, minutes)) == len(RECIPES):
            (name, first), (other, second) = order[:2]
            overlap = "" if first.high < second.low else ", intervals overlap"
            seeds += [each.seeds for _, each in order]
            parts.append(f"after {minutes:g} CPU minutes {TITLES[name]} ({first.short}) is ahead of {TITLES[other]} "
                         f"({second.short}){overlap}")  # fmt: skip
    if not parts:
        return "Not all algorithms have rows yet."
    return f"With {min(seeds)} seed{'s' * (min(seeds) > 1)} each, {'; '.join(parts)}."


def references(rows: Sequence[AlgorithmRow]) -> str:
    """Return a sentence that compares the fastest policy of all CPU times with the agents that are not trained here."""
    found = [(name, each) for name in REFERENCES if (each := result(rows, name, None))]
    policies = [(each.time, minutes, name) for minutes in BUDGETS for name, each in best(rows, minutes)]
    if not policies or not found:
        return "There is no policy to compare yet."
    time, minutes, name = min(policies)
    slower, faster = (_names([(agent, each) for agent, each in found if (each.time <= time) == wanted])
                      for wanted in (False, True))  # fmt: skip
    return (f"The fastest policy, of {TITLES[name]} after {minutes:g} minutes ({_settling(time)}), is faster than "
            f"{slower}; training does not pay where {faster} can be used.")  # fmt: skip


def _names(agents: Sequence[tuple[str, _Result]]) -> str:
    """Return the names of agents with their median settling times."""
    return " and ".join(f"`{name}` ({_settling(each.time)})" for name, each in agents) or "none of the other agents"


def page(rows: Sequence[AlgorithmRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` is the file of the rows with its comment."""
    lines = []
    for name in RECIPES:
        own = {minutes: each for minutes in BUDGETS if (each := result(rows, name, minutes))}
        if own:
            latest = own[max(own)]
            seeds = " / ".join(dict.fromkeys(str(each.seeds) for each in own.values()))
            cells = [own[minutes].text if minutes in own else "" for minutes in BUDGETS]
            lines.append((f"{TITLES[name]} ({seeds})", *cells, "", millimetres(latest.vibration)))
    for name in REFERENCES:
        if each := result(rows, name, None):
            lines.append((f"`{name}`", *[""] * len(BUDGETS), each.text, millimetres(each.vibration)))
    heads = ("agent (seeds)", *(f"{minutes:g} min" for minutes in BUDGETS), "not trained here", "vibration")
    body = BODY.format(table="\n".join(markdown_table(heads, lines)), environment=ENVIRONMENT, first=EPISODES.start,
                       final=EPISODES.stop - 1, last=BUDGETS[-1], ends=_ends(rows))  # fmt: skip
    answer = ANSWER.format(best=comparison(rows), references=references(rows))
    return screen("Algorithms at equal CPU time", QUESTION, answer, body, files, "algorithms")


def _ends(rows: Sequence[AlgorithmRow]) -> str:
    """Return the range of the steps of the longest runs, in percent of their schedules; "" without rows."""
    done = sorted(100.0 * row.steps / STEPS[row.algorithm] for row in rows if row.minutes == BUDGETS[-1] and row.steps)
    return f" (here {done[0]:.0f} to {done[-1]:.0f} % of its schedules)" if done else ""


def _settling(time: float) -> str:
    return f"{time:.2f} s" if math.isfinite(time) else "half do not settle"


def _seconds(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"
