"""Metrics of episodes, and their aggregates over episodes (mean, median or share)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of
from flexman_gym.common.registry import Registry
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.rollouts import EpisodeRecord, rollout
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

MEAN, MEDIAN, SHARE, LARGEST = "mean", "median", "share", "largest"


@dataclass(frozen=True)
class Metric:
    """Number computed from the record of an episode, and its aggregate over episodes.

    Attributes:
        name: key in METRICS.
        header: header of its column in a table.
        unit: unit of the number, "" for a number without a unit.
        better: "high" or "low", the better values.
        function: function from the record of an episode to the number.
        statistic: aggregate over episodes: "mean", "median" (with a bootstrap interval in tables), "share" (a mean
            between 0 and 1, in percent in tables) or "largest".
        scale: factor from the unit to the unit of the table.
        for_all_tasks: True if the metric applies to every task; False if only to tasks whose `metrics` contain it.
    """

    name: str
    header: str
    unit: str
    better: str
    function: Callable[[EpisodeRecord], float]
    statistic: str
    scale: float = 1.0
    for_all_tasks: bool = True

    def evaluate(self, records: Sequence[EpisodeRecord]) -> float:
        """Return the aggregate over episodes; the median of an even number is the upper of the middle two."""
        return self.aggregate(self.values(records))

    def aggregate(self, values: Array) -> float:
        """Return the aggregate, mean, median or largest, of the numbers (b,) of b episodes; see `evaluate`."""
        if self.statistic == LARGEST:
            return float(np.max(values))
        return upper_median(values) if self.statistic == MEDIAN else float(np.mean(values))

    def values(self, records: Sequence[EpisodeRecord]) -> Array:
        """Return the number of each of b episodes, (b,)."""
        return np.array([self.function(record) for record in records])

    def interval(self, records: Sequence[EpisodeRecord]) -> tuple[float, float, float]:
        """Return the median over episodes and the ends of its bootstrap interval."""
        return median_interval(self.values(records))


def _settling_time(record: EpisodeRecord) -> float:
    return np.inf if record.failure else settling_time(record.errors, record.band, record.period)


def _vibration(record: EpisodeRecord) -> float:
    return np.inf if record.failure else peak_to_peak(record.tips, record.period)


def _mean_square(values: Array | None) -> float:
    """Return the mean square of an array; 0 for None."""
    return 0.0 if values is None else float(np.mean(np.square(values)))


def _excess(record: EpisodeRecord) -> Array:
    """Return the excess (T,) beyond the limits, 0 within."""
    return np.zeros(1) if record.excess is None else np.maximum(record.excess, 0.0)


# A failed episode has an infinite settling time and an infinite vibration.
METRICS: Registry[Metric] = Registry("metric", {metric.name: metric for metric in (
    Metric("reward", "reward", "", "high", lambda record: float(record.rewards.sum()), MEAN),
    Metric("settled", "settled", "", "high", lambda record: float(np.isfinite(_settling_time(record))), SHARE),
    Metric("settling_time", "settling, s", "s", "low", _settling_time, MEDIAN, for_all_tasks=False),
    Metric("vibration", "p-p, mm", "m", "low", _vibration, MEDIAN, 1e3),
    Metric("error", "error, mm", "m", "low", lambda record: final_error(record.errors, record.period), MEDIAN, 1e3,
           for_all_tasks=False),
    Metric("rms_error", "RMS error, mm", "m", "low", lambda record: rms(record.errors), MEDIAN, 1e3,
           for_all_tasks=False),
    Metric("roughness", "roughness", "", "low", lambda record: roughness(record.actions), MEAN),
    Metric("effort", "effort", "", "low", lambda record: effort(record.actions), MEAN),
    Metric("failed", "failed", "", "low", lambda record: float(record.failure != ""), SHARE),
)})  # fmt: skip
"""Metrics of `evaluate`: name -> `Metric`. "reward" is the return, the sum of the rewards of an episode."""
LIMIT_METRICS = (
    Metric("violations", "violations of 1000", "", "low", lambda record: 1e3 * float(_excess(record).any()), MEAN),
    Metric("excess", "excess", "", "low", lambda record: float(_excess(record).max()), LARGEST),
    Metric("violation_time", "violation, s", "s", "low",
           lambda record: record.period * np.count_nonzero(_excess(record)), MEAN),
)  # fmt: skip
"""Metrics of environments with limits that are recorded: number of episodes with a violation per 1000 episodes, largest
excess as a fraction of the limit, and mean time in violation."""
SAFETY_METRIC = Metric("change", "change", "", "low", lambda record: _mean_square(record.changes), MEAN)
"""Metric of environments with a safety filter: mean square of its changes of the torques as fractions of the limits."""
DEFAULT_TASK_METRICS = ("settling_time", "error")  # metrics of a task without the attribute `metrics`


def task_metrics(task: Any) -> tuple[Metric, ...]:
    """Return the metrics of a task: the general metrics, and the metrics named in its attribute `metrics`."""
    names = getattr(task, "metrics", DEFAULT_TASK_METRICS)
    checked = [one_of("task.metrics", name, METRICS) for name in names]
    return tuple(metric for name, metric in METRICS.items() if metric.for_all_tasks or name in checked)


def limit_metrics(record: EpisodeRecord) -> tuple[Metric, ...]:
    """Return the metrics of recorded limits and of the safety filter that apply to a record."""
    limits = () if record.excess is None else LIMIT_METRICS
    return limits if record.changes is None else (*limits, SAFETY_METRIC)


def evaluate(
    agent: object,
    environment: str | Configuration,
    seeds: Sequence[int] | int,
    safety: bool = False,
) -> dict[str, float]:
    """Simulate one episode for each seed and return all metrics of METRICS over these episodes.

    The metric "reward" is the return, the undiscounted sum of the rewards of the control periods of an episode. The
    metric "vibration" is the peak-to-peak motion of the tip in the last 3 s (m), whereas `tip_vibration` in `info` is a
    speed (m/s). The metric "effort" is the mean square of the commanded torques as fractions of their limits.

    Args:
        agent: name of a baseline or a shipped policy, folder of a run, Controller, or another object of `find_agent`.
        environment: id, id and condition such as "FlexRRR-v0/delay", path of a file, or Configuration.
        seeds: seeds of the episodes; a number n <= 100 stands for the first n test seeds.
        safety: True to run the agent with the setting safety=True of the environment, which needs the extra `mpc`.

    Returns:
        Metrics by name. Means: reward, roughness and effort; medians: settling_time (s), vibration (m), error (m) and
        rms_error (m); shares of the episodes: settled and failed. With limits of strain, spring torque or workspace or
        a margin also the LIMIT_METRICS violations, excess and violation_time (s), and with a safety filter the mean
        square "change" of the torques.

    Raises:
        ValueError, FileNotFoundError: for an unknown agent or environment.

    Examples:
        >>> result = fm.evaluate("lqr", "FlexOne-v0", seeds=range(2))
        >>> result["settled"], result["failed"]
        (1.0, 0.0)
        >>> result["settling_time"] < 3.0  # s
        True
    """
    return all_metrics(rollout(agent, environment, seeds, safety=safety).records)


def all_metrics(records: Sequence[EpisodeRecord]) -> dict[str, float]:
    """Return all metrics of METRICS over some episodes, and those of limits and of the safety filter if they apply."""
    metrics = (*METRICS.values(), *limit_metrics(records[0]))
    return {metric.name: metric.evaluate(records) for metric in metrics}


def median_intervals(records: Sequence[EpisodeRecord]) -> dict[str, tuple[float, float]]:
    """Return the ends of the bootstrap intervals of the medians of METRICS over some episodes."""
    medians = [metric for metric in METRICS.values() if metric.statistic == MEDIAN]
    return {metric.name: metric.interval(records)[1:] for metric in medians}
