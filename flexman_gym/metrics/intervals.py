"""Intervals: within which the median of some values lies."""

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import positive, refusal, whole_number
from flexman_gym.metrics.samples import samples

MOST_DRAWN = 10**8  # numbers in all samples


def upper_median(values: Array) -> float:
    """Gives the median of values (N,), which may be infinite; of an even number of them the upper of the middle two.

    Raises:
        ValueError: for values without a sample.
    """
    return float(_medians(samples("values", values, 1)[None])[0])


def median_interval(values: Array, level: float = 0.95, draws: int = 2000) -> tuple[float, float, float]:
    """Gives the median of values (N,), which may be infinite, and its bootstrap interval (low, high).

    The interval holds the given share of the medians of samples drawn with replacement (Efron and Tibshirani, An
    Introduction to the Bootstrap, chapter 13); the draws are the same every time.

    Raises:
        ValueError: for values without a sample, a level that is not above 0 and below 1, and for draws that are no
            whole number from 1 on or hold more than a hundred million numbers together.
    """
    result = samples("values", values, 1)
    level = positive("level", level)
    if not level < 1.0:
        raise refusal("level", level, "a number > 0 and < 1")
    draws = whole_number("draws", draws, 1, max(1, MOST_DRAWN // len(result)))
    picked = np.random.default_rng(0).integers(len(result), size=(draws, len(result)))
    medians = np.sort(_medians(result[picked]))
    cut = round((1.0 - level) / 2.0 * (draws - 1))
    return upper_median(result), float(medians[cut]), float(medians[-1 - cut])


def _medians(rows: Array) -> Array:
    """Medians (r,) of rows; between infinity and a number the upper one, where a mean would say too much or nothing."""
    return np.sort(rows, axis=1)[:, rows.shape[1] // 2]
