"""Figures: what an episode is worth, one number each, and what many episodes are worth together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import one_of
from flexman_gym.control.controller import Controller
from flexman_gym.envs.description import Description
from flexman_gym.evaluation.entrants import Entrant
from flexman_gym.evaluation.rollout import Record, rollout
from flexman_gym.metrics import (
    effort,
    final_error,
    median_interval,
    peak_to_peak,
    rms,
    roughness,
    settling_time,
    upper_median,
)

MEAN, MEDIAN, SHARE = "mean", "median", "share"


@dataclass(frozen=True)
class Figure:
    """A number that an episode has.

    Attributes:
        name: by which it is known.
        head: of its column in a table.
        unit: of the number, "" for none.
        better: "high" or "low".
        of: function of a Record.
        many: how many episodes are summed up, by "mean", "median" (with an interval) or "share" (a mean in percent).
        scale: of the number in a table, beside its unit there.
        everywhere: whether it matters for every task, or only for those that name it.
    """

    name: str
    head: str
    unit: str
    better: str
    of: Callable[[Record], float]
    many: str
    scale: float = 1.0
    everywhere: bool = True

    def sum_up(self, records: Sequence[Record]) -> float:
        """Gives the mean or the median of episodes; of an even number of them the upper of the middle two."""
        result = self.each(records)
        return upper_median(result) if self.many == MEDIAN else float(np.mean(result))

    def each(self, records: Sequence[Record]) -> Array:
        """Gives the number of each of the episodes, (b,)."""
        return np.array([self.of(record) for record in records])

    def interval(self, records: Sequence[Record]) -> tuple[float, float, float]:
        """Gives the median of episodes and its bootstrap interval."""
        return median_interval(self.each(records))


def _settled(record: Record) -> float:
    return np.inf if record.failure else settling_time(record.errors, record.band, record.period)


def _vibration(record: Record) -> float:
    return np.inf if record.failure else peak_to_peak(record.tips, record.period)


# One that failed never settles and vibrates without end.
FIGURES = {figure.name: figure for figure in (
    Figure("reward", "reward", "", "high", lambda record: float(record.rewards.sum()), MEAN),
    Figure("settled", "settled", "", "high", lambda record: float(np.isfinite(_settled(record))), SHARE),
    Figure("settling_time", "settling, s", "s", "low", _settled, MEDIAN, everywhere=False),
    Figure("vibration", "p-p, mm", "m", "low", _vibration, MEDIAN, 1e3),
    Figure("error", "error, mm", "m", "low", lambda record: final_error(record.errors, record.period), MEDIAN, 1e3,
           everywhere=False),
    Figure("rms_error", "RMS error, mm", "m", "low", lambda record: rms(record.errors), MEDIAN, 1e3, everywhere=False),
    Figure("roughness", "roughness", "", "low", lambda record: roughness(record.actions), MEAN),
    Figure("effort", "effort", "", "low", lambda record: effort(record.actions), MEAN),
    Figure("failed", "failed", "", "low", lambda record: float(record.failure != ""), SHARE),
)}  # fmt: skip
"""What `evaluate` gives: name -> `Figure`."""
SETTLING = ("settling_time", "error")  # figures of a task that names none


def figures_of(task: Any) -> tuple[Figure, ...]:
    """Gives the figures that matter for a task: those of every task, and those that it names in `figures`."""
    own = [one_of("task.figures", name, FIGURES) for name in getattr(task, "figures", SETTLING)]
    return tuple(figure for name, figure in FIGURES.items() if figure.everywhere or name in own)


def evaluate(
    entrant: str | Entrant | Controller, environment: str | Description, seeds: Sequence[int] | int
) -> dict[str, float]:
    """Gives every figure of FIGURES, summed up over an episode from each seed.

    Among them "vibration" is the motion of the tip from peak to peak in the last 3 s, in m (`tip_vibration` in an info
    is a speed, in m/s), and "effort" the mean square of what the motors were asked for.

    Args:
        entrant: see `rollout`.
        environment: see `rollout`.
        seeds: see `rollout`; a number of test seeds, such as 10, will do.

    Returns:
        reward, settled (share), settling_time (s), vibration (m), error (m), rms_error (m), roughness, effort and
        failed (share), by name.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.

    Examples:
        >>> found = fm.evaluate("lqr", "FlexOne-v0", seeds=range(2))
        >>> found["settled"], found["failed"]
        (1.0, 0.0)
    """
    records = rollout(entrant, environment, seeds).records
    return {name: figure.sum_up(records) for name, figure in FIGURES.items()}
