"""Statistics over episodes: medians, scores and shares with their intervals."""

from math import comb

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm, trim_mean

from flexman_gym.metrics import (
    improvements,
    interquartile_mean,
    mean,
    median_interval,
    normalised_scores,
    paired_score,
    performance_profile,
    share_interval,
    stratified_interval,
)

from oracles.assertions import refusal


def test_the_interval_of_equal_values_is_that_value_also_where_it_is_infinite():
    assert median_interval(np.full(20, 3.0)) == (3.0, 3.0, 3.0)
    assert median_interval(np.full(20, np.inf)) == (np.inf, np.inf, np.inf)
    assert median_interval(np.array([2.0])) == (2.0, 2.0, 2.0)


@pytest.mark.parametrize(("count", "total"), [(0, 10), (10, 10), (4, 10), (72, 100), (1, 2720)])
def test_the_bounds_of_a_share_are_the_probabilities_that_a_score_test_just_accepts(count, total):
    """Wilson's equation: (share - p)^2 = z^2 p (1 - p) / n at both bounds p, with z of the normal distribution."""
    share, low, high = share_interval(count, total)
    assert share == count / total and 0.0 <= low <= share <= high <= 1.0
    for bound in {low, high} - {0.0, 1.0}:
        assert (share - bound) ** 2 == pytest.approx(norm.ppf(0.975) ** 2 * bound * (1.0 - bound) / total)
    assert (low == 0.0) == (count == 0) and (high == 1.0) == (count == total), "a share of all is not certain"


def test_the_interval_of_a_share_is_the_mirror_of_that_of_the_rest_and_narrow_at_a_low_level():
    share, low, high = share_interval(7, 20)
    assert (1.0 - share, 1.0 - high, 1.0 - low) == pytest.approx(share_interval(13, 20))
    assert low < share_interval(7, 20, level=0.5)[1] < share < share_interval(7, 20, level=0.5)[2] < high
    for count, total in ((-1, 10), (11, 10), (1, 0), (0.5, 10)):
        assert "whole number" in refusal(lambda count=count, total=total: share_interval(count, total))


@pytest.mark.slow
@given(st.lists(st.floats(-1e6, 1e6) | st.just(np.inf), min_size=1, max_size=30))
def test_the_median_is_within_its_interval_and_never_half_way_to_infinity(values):
    middle, low, high = median_interval(np.array(values), draws=200)
    assert low <= middle <= high and {middle, low, high} <= set(values)
    assert middle == sorted(values)[len(values) // 2]
    assert median_interval(np.array(values), draws=200) == (middle, low, high), "the same draws every time"


def test_more_infinite_than_finite_values_have_an_infinite_median():
    assert median_interval(np.array([1.0, 2.0, np.inf, np.inf, np.inf]))[0] == np.inf
    assert median_interval(np.array([1.0, 2.0, 3.0, np.inf, np.inf]))[0] == 3.0
    assert median_interval(np.array([1.0, np.inf]))[0] == np.inf, "one of two did not settle"
    middle, low, high = median_interval(np.append(np.arange(60.0), [np.inf] * 40))
    assert np.isfinite([middle, low]).all() and 36 <= low < middle == 50.0 and high > 58


def test_the_interval_is_that_of_the_exact_distribution_of_resampled_medians():
    """A median of n draws is the k-th value or less where at least n // 2 + 1 draws are: a binomial tail."""
    n = 25
    below = [_tail(n, (k + 1) / n) for k in range(n)]
    low = next(k for k in range(n) if below[k] >= 0.025)
    high = next(k for k in range(n) if below[k] >= 0.975)
    middle, *interval = median_interval(np.arange(float(n)), draws=20_000)
    assert middle == 12.0 and np.abs(np.array(interval) - [low, high]).max() <= 1.0
    narrow = median_interval(np.arange(float(n)), level=0.5)
    assert interval[0] < narrow[1] <= 12.0 <= narrow[2] < interval[1]


def _tail(n, p):
    """Probability that more than half of n draws succeed."""
    return sum(comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(n // 2 + 1, n + 1))


def test_the_interval_covers_the_true_median_about_as_often_as_it_says():
    """200 samples of 31 normal numbers: 95 % of the intervals hold 0; 185 of 200 is three deviations below."""
    samples = np.random.default_rng(1).standard_normal((200, 31))
    covered = [low <= 0.0 <= high for _, low, high in (median_interval(each, draws=400) for each in samples)]
    assert 180 <= np.sum(covered) <= 199


def test_the_interval_of_equal_runs_is_that_of_one_run_and_wider_where_runs_differ():
    for size in (30, 31):
        episodes = np.random.default_rng(size).standard_normal(size)
        one = median_interval(episodes)
        assert median_interval(episodes[None]) == one
        assert median_interval(np.array([episodes] * 4)) == one
        middle, low, high = median_interval(episodes + np.array([[-0.5], [-0.2], [0.1], [0.6]]))
        assert low < one[1] < one[2] < high and low < middle < high


@pytest.mark.slow
def test_the_interval_of_runs_contains_the_median_of_all_runs_about_as_often_as_it_says():
    """200 experiments of 10 runs in the same 40 episodes; run, episode and remainder are normal with deviations 1."""
    random, covered = np.random.default_rng(2), 0
    for _ in range(200):
        values = random.standard_normal((10, 1)) + random.standard_normal(40) + random.standard_normal((10, 40))
        _, low, high = median_interval(values, draws=400)
        covered += low <= 0.0 <= high
    _, *pooled = median_interval(values.ravel(), draws=400)
    assert 175 <= covered <= 200 and pooled[1] - pooled[0] < 0.7 * (high - low)


def test_no_values_are_refused_in_one_line():
    line = "values: array([], dtype=float64) is not allowed; give an array of 1"
    assert refusal(median_interval, np.zeros(0)).startswith(line)


NUMBERS = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30)


@pytest.mark.slow
@given(NUMBERS)
def test_the_interquartile_mean_is_the_trimmed_mean_that_rliable_takes(values):
    assert interquartile_mean(np.array(values)) == pytest.approx(trim_mean(values, 0.25), rel=1e-12, abs=1e-12)


def test_what_lies_in_the_outer_quarters_does_not_count():
    assert interquartile_mean(np.array([-1e9, 1.0, 2.0, 1e9])) == 1.5
    assert interquartile_mean(np.array([[9.0, 1.0, 2.0, -9.0], [0.0, 0.0, 0.0, 4.0]])).tolist() == [1.5, 0.0]
    assert interquartile_mean(np.array([1.0, 2.0, 3.0, np.inf])) == 2.5
    assert interquartile_mean(np.array([1.0, 2.0, np.inf, np.inf])) == np.inf


@pytest.mark.slow
def test_intervals_cover_the_truth_in_93_to_97_percent_of_1000_simulated_leagues():
    """Normal scores on three environments of different means, which together lie evenly around 0: so does their IQM."""
    leagues = np.random.default_rng(1).normal([-1.0, 0.0, 1.0], 1.0, (1000, 60, 3))
    for statistic in (interquartile_mean, mean):
        intervals = np.array([stratified_interval(each, statistic, draws=300) for each in leagues])
        covered = np.mean((intervals[:, 0] <= 0.0) & (intervals[:, 1] >= 0.0))
        assert 0.93 <= covered <= 0.97, statistic


@pytest.mark.slow
def test_the_interval_of_a_mean_is_that_of_its_standard_error():
    """A mean of 400 samples is normal; strata of their own means add nothing to its spread."""
    scores = np.random.default_rng(2).standard_normal((400, 2))
    scores = (scores - scores.mean(axis=0)) / scores.std(axis=0) + [-50.0, 50.0]
    low, high = stratified_interval(scores, mean, draws=5_000)
    assert [low, high] == pytest.approx([-1.96 / np.sqrt(800.0), 1.96 / np.sqrt(800.0)], rel=0.05)
    narrow = stratified_interval(scores, mean, level=0.5, draws=5_000)
    assert narrow[1] - narrow[0] == pytest.approx((high - low) * 0.6745 / 1.96, rel=0.08)
    assert stratified_interval(scores, mean, draws=5_000) == (low, high), "the same draws every time"


def test_environments_are_drawn_by_themselves():
    """Each stratum has one score, so all samples are equal."""
    assert stratified_interval(np.tile([1.0, 5.0], (20, 1)), mean) == (3.0, 3.0)


def test_a_profile_is_the_part_above_each_threshold():
    scores = np.array([[0.1, 0.4], [0.6, 0.9]])
    assert performance_profile(scores, np.array([0.0, 0.4, 0.5, 1.0])).tolist() == [1.0, 0.5, 0.5, 0.0]


def test_who_is_better_is_asked_in_the_same_episode():
    """Slightly better in nine of ten very different episodes: without pairing there would be no difference."""
    ours = 100.0 * np.arange(10.0)[:, None] + 1.0
    theirs = ours - 0.5
    theirs[0] += 1.0
    assert improvements(ours, theirs).ravel().tolist() == [0.0] + 9 * [1.0]
    assert improvements(ours, ours).mean() == 0.5
    assert (improvements(ours, theirs) + improvements(theirs, ours) == 1.0).all()
    failed = np.array([[np.inf], [1.0]])
    assert improvements(failed, failed).ravel().tolist() == [0.5, 0.5]
    line = refusal(improvements, ours, theirs[:9])
    assert line == "others: (9, 1) is not allowed; give scores of the same episodes, (10, 1)"


def test_scores_are_0_and_1_at_the_ends_of_their_scale_and_go_on_beyond():
    scores = normalised_scores(np.array([100.0, 300.0, 350.0, 50.0]), 100.0, 300.0, 500.0)
    assert scores.tolist() == [0.0, 1.0, 1.25, -0.25]


def test_ends_that_are_too_close_are_no_scale():
    rewards = np.array([100.0])
    assert normalised_scores(rewards, 100.0, 124.9, 500.0) is None
    assert normalised_scores(rewards, 100.0, 125.0, 500.0).tolist() == [0.0]
    assert normalised_scores(rewards, 300.0, 100.0, 500.0) is None, "who knows all is worse than who does nothing"
    assert refusal(normalised_scores, rewards, 0.0, 1.0, 0.0).startswith("largest: 0.0 is not allowed")
    assert refusal(normalised_scores, rewards, 0.0, np.inf, 1.0).startswith("one: inf is not allowed")


def test_a_paired_score_has_no_width_where_all_differ_alike_from_episode_to_episode():
    """The level of rewards differs much between episodes; the interval of a score stays narrow."""
    worth = 50.0 * np.random.default_rng(3).standard_normal(30)
    assert paired_score(worth, worth, worth + 200.0) == (0.0, 0.0, 0.0)
    assert paired_score(worth + 200.0, worth, worth + 200.0) == (1.0, 1.0, 1.0)
    assert paired_score(worth + 300.0, worth, worth + 200.0) == pytest.approx((1.5, 1.5, 1.5))
    noisy = worth + 300.0 + np.random.default_rng(4).standard_normal(30)
    middle, low, high = paired_score(noisy, worth, worth + 200.0)
    assert middle == pytest.approx((noisy - worth).mean() / 200.0)
    error = 1.96 * (noisy - worth).std() / 200.0 / np.sqrt(30.0)
    assert [low, high] == pytest.approx([middle - error, middle + error], rel=1e-3)
    assert "level" in refusal(paired_score, noisy, worth, worth + 1.0, 1.0)
