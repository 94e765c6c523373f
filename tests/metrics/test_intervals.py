"""Intervals: the median of values that may be infinite, and its bootstrap interval."""

from math import comb

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from flexman_gym.metrics import median_interval

from oracles.refusals import refusal


def test_the_interval_of_equal_values_is_that_value_also_where_it_is_infinite():
    assert median_interval(np.full(20, 3.0)) == (3.0, 3.0, 3.0)
    assert median_interval(np.full(20, np.inf)) == (np.inf, np.inf, np.inf)
    assert median_interval(np.array([2.0])) == (2.0, 2.0, 2.0)


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


def test_no_values_are_refused_in_one_line():
    line = "values: array([], dtype=float64) is not allowed; give an array of 1"
    assert refusal(median_interval, np.zeros(0)).startswith(line)
