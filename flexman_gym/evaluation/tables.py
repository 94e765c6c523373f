"""Table of the metrics of several agents."""

from collections.abc import Mapping, Sequence
from textwrap import wrap

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.formatting import WIDTH, millimetres, number_text, percent, text_table
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.metrics import MEDIAN, SHARE, Metric, limit_metrics, task_metrics
from flexman_gym.evaluation.rollouts import EpisodeRecord
from flexman_gym.evaluation.shares import share_text
from flexman_gym.metrics import median_interval
from flexman_gym.simulation.methods import DEFAULT_METHOD

MAX_NAME_LENGTH = 22  # characters of a name in the table
LEFT_OUT = ("roughness", "effort")  # metrics without a column: `evaluate` and `flexman evaluate --json` have all
CAPTION = "medians and shares with 95 % intervals (bootstrap, Wilson); the reward is a mean"
LIMIT_CAPTION = "violations: episodes of 1000; excess: largest of all, as a fraction of the limit; time: mean"
ALL_SEEDS = "all seeds"  # name of the row over all training runs


def metrics_table(
    results: Mapping[str, Sequence[EpisodeRecord]], environment: Configuration, all_seeds: bool = False, name: str = ""
) -> str:
    """Return a table, as text, with the metrics of the task and one row for each agent.

    Args:
        results: name of an agent -> records of its episodes; the seeds are the same for all agents.
        environment: environment of the episodes.
        all_seeds: True if the agents are training runs that differ in the seed of the training. A last row then has the
            metrics over all runs, with intervals that contain the spread between the runs, see `median_interval`.
        name: name of the environment in the title; "" for its id with the names of changed settings.

    Returns:
        Lines of text of at most 100 characters: title, headers, one row for each agent, and a caption.
    """
    first = next(iter(results.values()))
    metrics = (*task_metrics(environment.task), *limit_metrics(first[0]))
    columns = [each for each in metrics if each.name not in LEFT_OUT]
    title = f"{len(first)} episodes of {name or _environment_text(environment)}, the same for all"
    title += f", reward {kind}" if isinstance(kind := getattr(environment.task, "reward", None), str) else ""
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
    return "\n".join([*wrap(title, WIDTH), *text_table(headers, rows), *caption])


def _environment_text(environment: Configuration) -> str:
    """Return the id of an environment with the names of its changed settings."""
    settings = environment.given.keys() - ({"method"} if environment.method == DEFAULT_METHOD else set())
    return f"{environment.id} ({', '.join(sorted(settings)) or 'default settings'})"


def _cell(metric: Metric, values: Array) -> str:
    """Return the aggregate of the numbers (N,) of N episodes, or (S, N) of S training runs, as text."""
    if metric.statistic == MEDIAN:
        if not np.isfinite((interval := median_interval(values))[0]):
            return "-"
        middle, low, high = (_number(metric, *each) for each in zip(interval, (3, 2, 2), strict=True))
        return middle if low == high == middle else f"{middle} ({low}-{high})"
    result = metric.aggregate(values)
    if metric.statistic == SHARE:  # runs share their episodes, so that a share over them has no interval here
        text = share_text(result, values.size) if values.ndim == 1 else percent(result)
        return text.replace(" to ", "-").replace(" %", "%")
    return f"{result:.1f}" if abs(result) >= 10.0 else f"{result:.3f}"


def _number(metric: Metric, value: float, digits: int) -> str:
    """Return a number of an interval in the unit of its header; "inf" for that of episodes that do not settle."""
    if not np.isfinite(value):
        return "inf"
    if metric.unit == "m":
        return millimetres(value).removesuffix(" mm")
    return number_text(metric.scale * value, digits)


def _shorten(name: str) -> str:
    return name if len(name) <= MAX_NAME_LENGTH else f"...{name[3 - MAX_NAME_LENGTH :]}"
