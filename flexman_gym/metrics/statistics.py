"""Statistics over episodes: medians, means, scores and shares with their intervals.

The methods follow Agarwal et al., Deep reinforcement learning at the edge of the statistical precipice, NeurIPS
2021 (rliable). An array of scores (N, M) has the scores of one agent in N episodes on each of M environments. The
return of an episode is the sum of its rewards.
"""

from collections.abc import Callable
from statistics import NormalDist

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, positive, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.metrics.signals import check_samples

MAX_EPISODES = 10**9  # largest number of episodes of a share
MAX_DRAWN = 10**8  # largest number of values in all bootstrap samples of an interval


def upper_median(values: Array) -> float:
    """Return the median of values, which may be infinite; for an even number of values, the upper of the middle two.

    Args:
        values: (N,).
    """
    return float(_medians(check_samples("values", values, 1)[None])[0])


def median_interval(values: Array, level: float = 0.95, draws: int = 2000) -> tuple[float, float, float]:
    """Return the median of values and the bounds (low, high) of its percentile bootstrap interval.

    The interval contains a given fraction of the medians of samples drawn with replacement (Efron and Tibshirani, An
    Introduction to the Bootstrap, chapter 13). Every call draws the same samples.

    For S training runs, a sample draws S runs and N episodes, both with replacement, so that the interval contains the
    spread between the runs (hierarchical bootstrap). The episodes of a sample are the same for all its runs, as all
    runs are evaluated on the same episodes; the interval of equal runs is that of one run.

    Args:
        values: (N,) or (S, N), which may be infinite.
        level: fraction of the medians in the interval, above 0 and below 1.
        draws: number of bootstrap samples, with at most a hundred million values in total.
    """
    result = np.atleast_2d(check_samples("values", values, 1, 2))
    level = _checked_level(level)
    draws = whole_number("draws", draws, 1, max(1, MAX_DRAWN // result.size))
    random, (runs, size) = np.random.default_rng(0), result.shape
    episodes = random.integers(size, size=(draws, 1, size))
    samples = result[random.integers(runs, size=(draws, runs, 1)), episodes]
    medians = np.sort(_medians(samples.reshape(draws, -1)))
    cut = round((1.0 - level) / 2.0 * (draws - 1))
    return upper_median(result.ravel()), float(medians[cut]), float(medians[-1 - cut])


def share_interval(count: int, total: int, level: float = 0.95) -> tuple[float, float, float]:
    """Return a share of independent episodes and the bounds (low, high) of its interval by Wilson (1927).

    The bounds are the probabilities whose score test does not reject the share (Probable inference, the law of
    succession, and statistical inference, J. Am. Stat. Assoc. 22, 209). The interval of 0 or all of the episodes is not
    a point, as that of a bootstrap is.

    Args:
        count: number of episodes with a property, 0 to `total`.
        total: number of all episodes.
        level: probability of an interval that contains the true share, above 0 and below 1.
    """
    total = whole_number("total", total, 1, MAX_EPISODES)
    count = whole_number("count", count, 0, total)
    square = NormalDist().inv_cdf(0.5 * (1.0 + _checked_level(level))) ** 2
    share, middle = count / total, (count + 0.5 * square) / (total + square)
    half = np.sqrt(square * (share * (1.0 - share) * total + 0.25 * square)) / (total + square)
    low, high = float(middle - half), float(middle + half)
    return share, low if count else 0.0, high if count < total else 1.0  # exact ends, without rounding


def _checked_level(level: float) -> float:
    """Return a level after a check: above 0 and below 1."""
    if not positive("level", level) < 1.0:
        raise value_error("level", level, "a number > 0 and < 1")
    return level


def _medians(rows: Array) -> Array:
    """Return the medians (r,) of rows (r, N); the upper of the middle two values, as their mean could be infinite."""
    return np.sort(rows, axis=1)[:, rows.shape[1] // 2]


TRIMMED_FRACTION = 0.25  # fraction of the values excluded from the interquartile mean at each end
MIN_SPAN = 0.05  # smallest difference of the two reference returns, as a fraction of the largest return

Statistic = Callable[[Array], Array]  # function of values (..., K) along the last axis


def interquartile_mean(values: Array) -> Array:
    """Return the mean of the middle half of values, without a quarter of them, rounded down, at each end.

    Args:
        values: (..., K) values; the mean is taken along the last axis.
    """
    result = np.sort(check_samples("values", values, 1, 2), axis=-1)
    cut = int(TRIMMED_FRACTION * result.shape[-1])
    return np.mean(result[..., cut : result.shape[-1] - cut], axis=-1)


def mean(values: Array) -> Array:
    """Return the mean of values along the last axis.

    Args:
        values: (..., K).
    """
    return np.mean(check_samples("values", values, 1, 2), axis=-1)


def stratified_interval(
    scores: Array, statistic: Statistic = interquartile_mean, level: float = 0.95, draws: int = 2000
) -> tuple[float, float]:
    """Return the stratified bootstrap interval (low, high) of a statistic of scores.

    Episodes are drawn with replacement within each environment, so that every environment keeps its number of episodes.
    The interval contains a given fraction of the statistics of these samples. Every call draws the same samples.

    Args:
        scores: (N, M) scores of an agent.
        statistic: function of values (..., K) along the last axis.
        level: fraction of the statistics in the interval, above 0 and below 1.
        draws: number of bootstrap samples, with at most a hundred million values in total.
    """
    result = check_samples("scores", scores, 2)
    draws = whole_number("draws", draws, 1, max(1, MAX_DRAWN // result.size))
    count, strata = result.shape
    indices = np.random.default_rng(0).integers(count, size=(draws, count, strata))
    return _interval(statistic(result[indices, np.arange(strata)].reshape(draws, -1)), level)


def paired_score(
    returns: Array, zeros: Array, ones: Array, level: float = 0.95, draws: int = 2000
) -> tuple[float, float, float]:
    """Return the score of an agent and the bounds (low, high) of its bootstrap interval.

    The score is linear in the mean return; the mean returns of two reference agents have the scores 0 and 1. Bootstrap
    samples draw the returns of the three agents in an episode together.

    Args:
        returns: (N,) returns of the agent.
        zeros: (N,) returns, in the same episodes, of the reference agent whose mean return defines the score 0.
        ones: (N,) returns, in the same episodes, of the reference agent whose mean return defines the score 1.
        level: see `stratified_interval`.
        draws: see `stratified_interval`.
    """
    stacked = np.stack([check_samples("returns", each, 1) for each in (returns, zeros, ones)])
    draws = whole_number("draws", draws, 1, max(1, MAX_DRAWN // stacked.size))
    indices = np.random.default_rng(0).integers(stacked.shape[1], size=(draws, stacked.shape[1]))
    means, zero, one = stacked[:, np.vstack([np.arange(stacked.shape[1]), indices])].mean(axis=-1)
    scores = (means - zero) / (one - zero)
    return float(scores[0]), *_interval(scores[1:], level)


def _interval(values: Array, level: float) -> tuple[float, float]:
    """Return the central interval (low, high) that contains the fraction `level` of values (K,)."""
    level = _checked_level(level)
    low, high = np.quantile(values, [0.5 * (1.0 - level), 0.5 * (1.0 + level)], method="nearest")
    return float(low), float(high)


def performance_profile(scores: Array, thresholds: Array) -> Array:
    """Return the performance profile (T,): the fraction of scores above each threshold.

    See Dolan and More, Benchmarking optimization software with performance profiles, Mathematical Programming 2002.

    Args:
        scores: (N, M) scores of an agent.
        thresholds: (T,) scores.
    """
    result, levels = check_samples("scores", scores, 2), check_samples("thresholds", thresholds, 1)
    above: Array = np.mean(result.ravel() > levels[:, None], axis=-1)
    return above


def improvements(scores: Array, others: Array) -> Array:
    """Return 1 for each episode in which an agent scores higher than a second agent, 0 if lower, 0.5 if equal (N, M).

    The mean of the result is the paired probability of improvement; `stratified_interval` with the statistic `mean`
    returns its interval.

    Args:
        scores: (N, M) scores of the agent.
        others: (N, M) scores of the second agent in the same episodes.
    """
    own, other = check_samples("scores", scores, 2), check_samples("others", others, 2)
    if own.shape != other.shape:
        raise value_error("others", other.shape, f"scores of the same episodes, {own.shape}")
    return np.where(own == other, 0.5, own > other)


def normalised_scores(returns: Array, zero: float, one: float, largest: float) -> Array | None:
    """Return scores (...), linear in the returns; None if the two reference returns are too close.

    They are too close if their difference is negative, or below a twentieth of the largest return.

    Args:
        returns: (...) returns of episodes.
        zero: return with the score 0.
        one: return with the score 1.
        largest: largest possible return of an episode.
    """
    result = check_samples("returns", returns, 0, 1, 2)
    span = finite("one", one) - finite("zero", zero)
    return None if span < MIN_SPAN * positive("largest", largest) else (result - zero) / span
