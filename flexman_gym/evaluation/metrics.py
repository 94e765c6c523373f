"""Metrics of episodes: one number each, their mean, median or share over episodes, and a table of agents."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of
from flexman_gym.control.controller import Controller
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent import AgentSpec
from flexman_gym.evaluation.rollout import EpisodeRecord, rollout
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
class Metric:
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
    of: Callable[[EpisodeRecord], float]
    many: str
    scale: float = 1.0
    everywhere: bool = True

    def sum_up(self, records: Sequence[EpisodeRecord]) -> float:
        """Return the mean or the median over episodes; of an even number of them the upper of the middle two."""
        return self.summary(self.each(records))

    def summary(self, values: Array) -> float:
        """Return the mean or the median of the numbers (b,) of episodes, see `sum_up`."""
        return upper_median(values) if self.many == MEDIAN else float(np.mean(values))

    def each(self, records: Sequence[EpisodeRecord]) -> Array:
        """Gives the number of each of the episodes, (b,)."""
        return np.array([self.of(record) for record in records])

    def interval(self, records: Sequence[EpisodeRecord]) -> tuple[float, float, float]:
        """Gives the median of episodes and its bootstrap interval."""
        return median_interval(self.each(records))


def _settling_time(record: EpisodeRecord) -> float:
    return np.inf if record.failure else settling_time(record.errors, record.band, record.period)


def _vibration(record: EpisodeRecord) -> float:
    return np.inf if record.failure else peak_to_peak(record.tips, record.period)


# One that failed never settles and vibrates without end.
METRICS = {figure.name: figure for figure in (
    Metric("reward", "reward", "", "high", lambda record: float(record.rewards.sum()), MEAN),
    Metric("settled", "settled", "", "high", lambda record: float(np.isfinite(_settling_time(record))), SHARE),
    Metric("settling_time", "settling, s", "s", "low", _settling_time, MEDIAN, everywhere=False),
    Metric("vibration", "p-p, mm", "m", "low", _vibration, MEDIAN, 1e3),
    Metric("error", "error, mm", "m", "low", lambda record: final_error(record.errors, record.period), MEDIAN, 1e3,
           everywhere=False),
    Metric("rms_error", "RMS error, mm", "m", "low", lambda record: rms(record.errors), MEDIAN, 1e3, everywhere=False),
    Metric("roughness", "roughness", "", "low", lambda record: roughness(record.actions), MEAN),
    Metric("effort", "effort", "", "low", lambda record: effort(record.actions), MEAN),
    Metric("failed", "failed", "", "low", lambda record: float(record.failure != ""), SHARE),
)}  # fmt: skip
"""What `evaluate` gives: name -> `Metric`."""
DEFAULT_TASK_METRICS = ("settling_time", "error")  # figures of a task that names none


def task_metrics(task: Any) -> tuple[Metric, ...]:
    """Gives the figures that matter for a task: those of every task, and those that it names in `figures`."""
    names: Any = getattr(task, "metrics", None)
    if names is None:
        names = getattr(task, "figures", DEFAULT_TASK_METRICS)
        if hasattr(task, "figures"):
            warnings.warn("task.figures is deprecated; give metrics", DeprecationWarning, stacklevel=2)
    own = [one_of("task.metrics", name, METRICS) for name in names]
    return tuple(figure for name, figure in METRICS.items() if figure.everywhere or name in own)


def evaluate(
    entrant: str | AgentSpec | Controller, environment: str | Configuration, seeds: Sequence[int] | int
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
    return {name: figure.sum_up(records) for name, figure in METRICS.items()}


MAX_NAME_LENGTH = 100  # letters in a line of the table
CAPTION = "medians with 95 % bootstrap intervals; shares, reward, roughness and effort are means"


def metrics_table(results: Mapping[str, Sequence[EpisodeRecord]], environment: Configuration) -> str:
    """Gives a table with a row for each entrant; its head says on which environment all of them were run.

    Args:
        results: name -> what happened in its episodes.
        environment: on which they were run.
    """
    setup = environment
    columns = task_metrics(setup.task)
    first = next(iter(results.values()))
    changes = ", ".join(sorted(environment.settings)) or "as it is"
    title = f"{len(first)} episodes of {environment.id} ({changes}), the same for all"
    heads = ["entrant", *(_head(figure, first[0].band) for figure in columns)]
    rows = [[_shorten(name), *(_cell(figure, records) for figure in columns)] for name, records in results.items()]
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    return "\n".join([title, *(_line(row, widths) for row in (heads, *rows)), CAPTION])


def _head(figure: Metric, band: float) -> str:
    return f"in {1e3 * band:.3g} mm" if figure.name == "settled" else figure.head


def _cell(figure: Metric, records: Sequence[EpisodeRecord]) -> str:
    if figure.many == MEDIAN:
        middle, low, high = (
            f"{figure.scale * value:.3g}" if np.isfinite(value) else "-" for value in figure.interval(records)
        )
        return f"{middle} ({low} to {high})"
    result = figure.sum_up(records)
    if figure.many == SHARE:
        return f"{result:.0%}"
    return f"{result:.1f}" if abs(result) >= 10.0 else f"{result:.3f}"


def _shorten(name: str) -> str:
    return name if len(name) <= MAX_NAME_LENGTH else f"...{name[3 - MAX_NAME_LENGTH :]}"


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Cells side by side, the first to the left."""
    others = [f"{cell:>{width}}" for cell, width in zip(cells[1:], widths[1:], strict=True)]
    return "  ".join([f"{cells[0]:<{widths[0]}}", *others]).rstrip()
