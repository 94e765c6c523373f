"""Statistics of many episodes: medians, means, scores, and their bootstrap intervals (Agarwal et al., NeurIPS 2021;
rliable).

Scores (N, M) are those of one agent in N episodes on each of M environments; those of another agent are of the same
episodes.
"""

from collections.abc import Callable

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, positive, value_error, whole_number
from flexman_gym.metrics.signals import check_samples

MAX_DRAWN = 10**8  # numbers in all samples of a bootstrap interval


def upper_median(values: Array) -> float:
    """Gives the median of values (N,), which may be infinite; of an even number of them the upper of the middle two.

    Raises:
        ValueError: for values without a sample.
    """
    return float(_medians(check_samples("values", values, 1)[None])[0])


def median_interval(values: Array, level: float = 0.95, draws: int = 2000) -> tuple[float, float, float]:
    """Gives the median of values (N,), which may be infinite, and its bootstrap interval (low, high).

    The interval holds the given share of the medians of samples drawn with replacement (Efron and Tibshirani, An
    Introduction to the Bootstrap, chapter 13); the draws are the same every time.

    Raises:
        ValueError: for values without a sample, a level that is not above 0 and below 1, and for draws that are no
            whole number from 1 on or hold more than a hundred million numbers together.
    """
    result = check_samples("values", values, 1)
    level = _checked_level(level)
    draws = whole_number("draws", draws, 1, max(1, MAX_DRAWN // len(result)))
    picked = np.random.default_rng(0).integers(len(result), size=(draws, len(result)))
    medians = np.sort(_medians(result[picked]))
    cut = round((1.0 - level) / 2.0 * (draws - 1))
    return upper_median(result), float(medians[cut]), float(medians[-1 - cut])


def _checked_level(level: float) -> float:
    if not positive("level", level) < 1.0:
        raise value_error("level", level, "a number > 0 and < 1")
    return level


def _medians(rows: Array) -> Array:
    """Medians (r,) of rows; between infinity and a number the upper one, where a mean would say too much or nothing."""
    return np.sort(rows, axis=1)[:, rows.shape[1] // 2]


CUT = 0.25  # of the scores at each end, which the interquartile mean leaves out
MIN_SPAN = 0.05  # of the largest reward, by which the ends of the scale of scores must differ

Statistic = Callable[[Array], Array]


def interquartile_mean(values: Array) -> Array:
    """Gives the mean of the middle half of values (..., K); a quarter of them, rounded down, is cut off at each end."""
    result = np.sort(check_samples("values", values, 1, 2), axis=-1)
    cut = int(CUT * result.shape[-1])
    return np.mean(result[..., cut : result.shape[-1] - cut], axis=-1)


def mean(values: Array) -> Array:
    """Gives the mean of values (..., K)."""
    return np.mean(check_samples("values", values, 1, 2), axis=-1)


def stratified_interval(
    scores: Array, statistic: Statistic = interquartile_mean, level: float = 0.95, draws: int = 2000
) -> tuple[float, float]:
    """Gives the bootstrap interval (low, high) of a statistic of scores (N, M).

    Episodes are drawn anew with replacement, for each environment by itself, so that each has as many as before. The
    interval holds the given share of the statistics of such samples; the draws are the same every time.

    Args:
        scores: (N, M).
        statistic: of values (..., K) along the last axis.
        level: above 0 and below 1.
        draws: how many samples.

    Raises:
        ValueError: for scores without a sample, another level, and draws that hold more than a hundred million numbers.
    """
    result = check_samples("scores", scores, 2)
    draws = whole_number("draws", draws, 1, max(1, MAX_DRAWN // result.size))
    count, strata = result.shape
    picked = np.random.default_rng(0).integers(count, size=(draws, count, strata))
    return _interval(statistic(result[picked, np.arange(strata)].reshape(draws, -1)), level)


def paired_score(
    rewards: Array, zeros: Array, ones: Array, level: float = 0.95, draws: int = 2000
) -> tuple[float, float, float]:
    """Gives the score of a mean reward, and its bootstrap interval, for which all three are drawn together.

    Args:
        rewards: (N,) of the entrant.
        zeros: (N,) in the same episodes, of those who mean 0.
        ones: (N,) in the same episodes, of those who mean 1.
        level: see `stratified_interval`.
        draws: see `stratified_interval`.

    Raises:
        ValueError: as there.
    """
    three = np.stack([check_samples("rewards", each, 1) for each in (rewards, zeros, ones)])
    draws = whole_number("draws", draws, 1, max(1, MAX_DRAWN // three.size))
    picked = np.random.default_rng(0).integers(three.shape[1], size=(draws, three.shape[1]))
    ours, zero, one = three[:, np.vstack([np.arange(three.shape[1]), picked])].mean(axis=-1)
    found = (ours - zero) / (one - zero)
    return float(found[0]), *_interval(found[1:], level)


def _interval(values: Array, level: float) -> tuple[float, float]:
    level = _checked_level(level)
    low, high = np.quantile(values, [0.5 * (1.0 - level), 0.5 * (1.0 + level)], method="nearest")
    return float(low), float(high)


def performance_profile(scores: Array, thresholds: Array) -> Array:
    """Gives the part (T,) of scores (N, M) above each of the thresholds (T,) (Dolan and More 2002)."""
    result, levels = check_samples("scores", scores, 2), check_samples("thresholds", thresholds, 1)
    above: Array = np.mean(result.ravel() > levels[:, None], axis=-1)
    return above


def improvements(scores: Array, others: Array) -> Array:
    """Says of each episode (N, M) whether its score is above that of another in the same episode: 1, 0, or 0.5 if even.

    Their mean is the paired probability of improvement; `stratified_interval` with `mean` gives its interval.

    Raises:
        ValueError: for others of another shape.
    """
    ours, theirs = check_samples("scores", scores, 2), check_samples("others", others, 2)
    if ours.shape != theirs.shape:
        raise value_error("others", theirs.shape, f"scores of the same episodes, {ours.shape}")
    return np.where(ours == theirs, 0.5, ours > theirs)


def normalised_scores(rewards: Array, zero: float, one: float, most: float) -> Array | None:
    """Gives rewards (...) on a scale that has 0 and 1 at two of them; None where these are too close to be one.

    They are too close below a twentieth of the largest reward, and where the reward at 1 is not the larger one.

    Args:
        rewards: of episodes.
        zero: the reward that means 0.
        one: the reward that means 1.
        most: the largest reward that an episode can have.
    """
    result = check_samples("rewards", rewards, 0, 1, 2)
    span = finite("one", one) - finite("zero", zero)
    return None if span < MIN_SPAN * positive("most", most) else (result - zero) / span
