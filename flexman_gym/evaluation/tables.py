"""Table of the metrics of several agents."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.formatting import millimetres, percent
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.metrics import MEDIAN, SHARE, Metric, limit_metrics, task_metrics
from flexman_gym.evaluation.rollouts import EpisodeRecord
from flexman_gym.evaluation.shares import share_text
from flexman_gym.metrics import median_interval
from flexman_gym.simulation.methods import DEFAULT_METHOD

MAX_NAME_LENGTH = 100  # characters of a name in the table
CAPTION = "medians and shares with 95 % intervals (bootstrap, Wilson); reward, roughness and effort are means"
LIMIT_CAPTION = "violations: episodes of 1000; excess: largest of all, as a fraction of the limit; time: mean"
ALL_SEEDS = "all seeds"  # name of the row over all training runs


def metrics_table(
    results: Mapping[str, Sequence[EpisodeRecord]], environment: Configuration, all_seeds: bool = False
) -> str:
    """Return a table, as text, with the metrics of the task and one row for each agent.

    Args:
        results: name of an agent -> records of its episodes; the seeds are the same for all agents.
        environment: environment of the episodes.
        all_seeds: True if the agents are training runs that differ in the seed of the training. A last row then has the
            metrics over all runs, with intervals that contain the spread between the runs, see `median_interval`.

    Returns:
        Lines of text: title, headers, one row for each agent, and a caption.
    """
    first = next(iter(results.values()))
    columns = (*task_metrics(environment.task), *limit_metrics(first[0]))
    settings = environment.given.keys() - ({"method"} if environment.method == DEFAULT_METHOD else set())
    changes = ", ".join(sorted(settings)) or "default settings"
    title = f"{len(first)} episodes of {environment.id} ({changes}), the same for all"
    within = f"in {1e3 * first[0].band:.3g} mm"
    headers = ["agent", *(within if metric.name == "settled" else metric.header for metric in columns)]
    values = {metric: [metric.values(records) for records in results.values()] for metric in columns}
    rows = [[_shorten(name), *(_cell(metric, values[metric][i]) for metric in columns)]
            for i, name in enumerate(results)]  # fmt: skip
    caption = [CAPTION, *[LIMIT_CAPTION] * (first[0].excess is not None)]
    if all_seeds:
        rows.append([ALL_SEEDS, *(_cell(metric, np.array(values[metric])) for metric in columns)])
        sampled = f"{len(results)} training runs and episodes"
        caption.append(f"{ALL_SEEDS}: intervals of a hierarchical bootstrap over {sampled}")
    widths = [max(map(len, column)) for column in zip(headers, *rows, strict=True)]
    return "\n".join([title, *(_line(row, widths) for row in (headers, *rows)), *caption])


def _cell(metric: Metric, values: Array) -> str:
    """Return the aggregate of the numbers (N,) of N episodes, or (S, N) of S training runs, as text."""
    if metric.statistic == MEDIAN:
        middle, low, high = (_number(metric, value) for value in median_interval(values))
        return f"{middle} ({low} to {high})" if {low, high} != {middle} else middle
    result = metric.aggregate(values)
    if metric.statistic == SHARE:  # runs share their episodes, so that a share over them has no interval here
        return share_text(result, values.size) if values.ndim == 1 else percent(result)
    return f"{result:.1f}" if abs(result) >= 10.0 else f"{result:.3f}"


def _number(metric: Metric, value: float) -> str:
    """Return a median in the unit of its header; lengths with the digits that count, "-" if not finite."""
    if not np.isfinite(value):
        return "-"
    return millimetres(value).removesuffix(" mm") if metric.unit == "m" else f"{metric.scale * value:.3g}"


def _shorten(name: str) -> str:
    return name if len(name) <= MAX_NAME_LENGTH else f"...{name[3 - MAX_NAME_LENGTH :]}"


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Return a line of the table, with the first cell aligned to the left and the rest to the right."""
    numbers = [f"{cell:>{width}}" for cell, width in zip(cells[1:], widths[1:], strict=True)]
    return "  ".join([f"{cells[0]:<{widths[0]}}", *numbers]).rstrip()
