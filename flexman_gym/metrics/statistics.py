"""Statistics over episodes: medians, means, scores and their bootstrap intervals.

The methods are those of Agarwal et al., NeurIPS 2021 (rliable).

Scores (N, M) are those of one agent in N episodes on each of M environments; the scores of a second agent come from the
same episodes.
"""

from collections.abc import Callable

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, positive, value_error, whole_number
from flexman_gym.metrics.signals import check_samples

MAX_DRAWN = 10**8  # numbers in all samples of a bootstrap interval


def upper_median(values: Array) -> float:
    """Return the median of values (N,), which may be infinite; of an even number of values, the upper middle one.

    Args:
        values: (N,).
    """
    return float(_medians(check_samples("values", values, 1)[None])[0])


def median_interval(values: Array, level: float = 0.95, draws: int = 2000) -> tuple[float, float, float]:
    """Return the median of values (N,), which may be infinite, and its bootstrap interval (low, high).

    The interval contains the given share of the medians of samples drawn with replacement (Efron and Tibshirani, An
    Introduction to the Bootstrap, chapter 13). The draws are the same in every call.

    Args:
        values: (N,).
        level: share of the medians in the interval, above 0 and below 1.
        draws: number of bootstrap samples, with at most a hundred million numbers in total.
    """
    result = check_samples("values", values, 1)
    level = _checked_level(level)
    draws = whole_number("draws", draws, 1, max(1, MAX_DRAWN // len(result)))
    indices = np.random.default_rng(0).integers(len(result), size=(draws, len(result)))
    medians = np.sort(_medians(result[indices]))
    cut = round((1.0 - level) / 2.0 * (draws - 1))
    return upper_median(result), float(medians[cut]), float(medians[-1 - cut])


def _checked_level(level: float) -> float:
    """Return a level after checking that it is above 0 and below 1."""
    if not positive("level", level) < 1.0:
        raise value_error("level", level, "a number > 0 and < 1")
    return level


def _medians(rows: Array) -> Array:
    """Return the medians (r,) of rows; of an even number of values the upper one, to avoid a mean with infinity."""
    return np.sort(rows, axis=1)[:, rows.shape[1] // 2]


TRIMMED_SHARE = 0.25  # of the scores at each end, excluded from the interquartile mean
MIN_SPAN = 0.05  # smallest difference of the two reference rewards, as a fraction of the largest reward

Statistic = Callable[[Array], Array]


def interquartile_mean(values: Array) -> Array:
    """Return the mean of the middle half of values (..., K); a quarter of them, rounded down, is cut off at each end.

    Args:
        values: (..., K).
    """
    result = np.sort(check_samples("values", values, 1, 2), axis=-1)
    cut = int(TRIMMED_SHARE * result.shape[-1])
    return np.mean(result[..., cut : result.shape[-1] - cut], axis=-1)


def mean(values: Array) -> Array:
    """Return the mean of values (..., K) along the last axis.

    Args:
        values: (..., K).
    """
    return np.mean(check_samples("values", values, 1, 2), axis=-1)


def stratified_interval(
    scores: Array, statistic: Statistic = interquartile_mean, level: float = 0.95, draws: int = 2000
) -> tuple[float, float]:
    """Return the stratified bootstrap interval (low, high) of a statistic of scores (N, M).

    Episodes are drawn with replacement within each environment, so that every environment keeps its number of episodes.
    The interval contains the given share of the statistics of these samples. The draws are the same in every call.

    Args:
        scores: (N, M).
        statistic: function of values (..., K) along the last axis.
        level: share of the statistics in the interval, above 0 and below 1.
        draws: number of bootstrap samples, with at most a hundred million numbers in total.
    """
    result = check_samples("scores", scores, 2)
    draws = whole_number("draws", draws, 1, max(1, MAX_DRAWN // result.size))
    count, strata = result.shape
    indices = np.random.default_rng(0).integers(count, size=(draws, count, strata))
    return _interval(statistic(result[indices, np.arange(strata)].reshape(draws, -1)), level)


def paired_score(
    rewards: Array, zeros: Array, ones: Array, level: float = 0.95, draws: int = 2000
) -> tuple[float, float, float]:
    """Return the score of a mean reward between two reference rewards, and its bootstrap interval (low, high).

    The three rewards of an episode are drawn together.

    Args:
        rewards: (N,) rewards of the agent.
        zeros: (N,) rewards in the same episodes of the agent whose mean defines the score 0.
        ones: (N,) rewards in the same episodes of the agent whose mean defines the score 1.
        level: see `stratified_interval`.
        draws: see `stratified_interval`.
    """
    stacked = np.stack([check_samples("rewards", each, 1) for each in (rewards, zeros, ones)])
    draws = whole_number("draws", draws, 1, max(1, MAX_DRAWN // stacked.size))
    indices = np.random.default_rng(0).integers(stacked.shape[1], size=(draws, stacked.shape[1]))
    own, zero, one = stacked[:, np.vstack([np.arange(stacked.shape[1]), indices])].mean(axis=-1)
    scores = (own - zero) / (one - zero)
    return float(scores[0]), *_interval(scores[1:], level)


def _interval(values: Array, level: float) -> tuple[float, float]:
    """Return the interval (low, high) that contains a share of values (K,)."""
    level = _checked_level(level)
    low, high = np.quantile(values, [0.5 * (1.0 - level), 0.5 * (1.0 + level)], method="nearest")
    return float(low), float(high)


def performance_profile(scores: Array, thresholds: Array) -> Array:
    """Return the fraction (T,) of scores (N, M) above each threshold (Dolan and More 2002).

    Args:
        scores: (N, M).
        thresholds: (T,).
    """
    result, levels = check_samples("scores", scores, 2), check_samples("thresholds", thresholds, 1)
    above: Array = np.mean(result.ravel() > levels[:, None], axis=-1)
    return above


def improvements(scores: Array, others: Array) -> Array:
    """Return for each episode (N, M) whether its score exceeds that of a second agent: 1, 0, or 0.5 for equal scores.

    Their mean is the paired probability of improvement; `stratified_interval` with `mean` returns its interval.

    Args:
        scores: (N, M) of the agent.
        others: (N, M) of the second agent in the same episodes.
    """
    own, other = check_samples("scores", scores, 2), check_samples("others", others, 2)
    if own.shape != other.shape:
        raise value_error("others", other.shape, f"scores of the same episodes, {own.shape}")
    return np.where(own == other, 0.5, own > other)


def normalised_scores(rewards: Array, zero: float, one: float, most: float) -> Array | None:
    """Return rewards (...) on a scale with 0 and 1 at two reference rewards, or None if these are too close.

    They are too close if their difference is below a twentieth of the largest reward, or negative.

    Args:
        rewards: (...) rewards of episodes.
        zero: reward with the score 0.
        one: reward with the score 1.
        most: largest possible reward of an episode.
    """
    result = check_samples("rewards", rewards, 0, 1, 2)
    span = finite("one", one) - finite("zero", zero)
    return None if span < MIN_SPAN * positive("most", most) else (result - zero) / span
