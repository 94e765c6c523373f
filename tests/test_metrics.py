"""Metrics: figures of signals whose answer is known, infinite values, the interval of a median, errors."""

from math import comb

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexman_gym.metrics import effort, final_error, median_interval, peak_to_peak, stabilisation_time

from oracles.refusals import refusal

PERIOD = 0.02
TIME = PERIOD * np.arange(501)  # 10 s


def test_a_tip_that_stands_still_on_its_target_has_stabilised_at_once():
    assert stabilisation_time(np.zeros(501), 0.02, PERIOD) == 0.0
    assert peak_to_peak(np.ones((501, 3)), PERIOD) == 0.0
    assert final_error(np.full(501, 0.3), PERIOD) == 0.3


@given(st.integers(0, 450), st.floats(0.001, 0.1))
def test_a_step_into_the_band_stabilises_at_its_first_sample_within(entry, band):
    errors = np.where(np.arange(501) < entry, 2 * band, band)  # on the edge is within
    assert stabilisation_time(errors, band, PERIOD) == entry * PERIOD
    errors[-1] = 2 * band
    assert stabilisation_time(errors, band, PERIOD) == np.inf


def test_a_decaying_vibration_stabilises_when_its_envelope_has_fallen_to_the_band():
    """|exp(-t) cos(50 pi t)|: a peak at every sample, so that the samples are the envelope."""
    errors = np.abs(np.exp(-TIME) * np.cos(50 * np.pi * TIME))
    expected = PERIOD * np.ceil(np.log(1 / 0.02) / PERIOD)
    assert stabilisation_time(errors, 0.02, PERIOD) == pytest.approx(expected)


def test_only_who_stays_a_whole_second_has_stabilised():
    for last, expected in ((450, 9.0), (451, np.inf)):
        assert stabilisation_time(np.where(np.arange(501) < last, 1.0, 0.0), 0.02, PERIOD) == expected
    assert stabilisation_time(np.zeros(50), 0.02, PERIOD) == np.inf, "less than a second was seen"
    assert stabilisation_time(np.zeros(51), 0.02, PERIOD) == 0.0


def test_an_error_that_is_no_number_is_outside_the_band():
    errors = np.zeros(501)
    errors[200] = np.nan
    assert stabilisation_time(errors, 0.02, PERIOD) == pytest.approx(201 * PERIOD)
    errors[200] = np.inf
    assert stabilisation_time(errors, 0.02, PERIOD) == pytest.approx(201 * PERIOD)


@given(st.floats(0.001, 1.0), st.integers(1, 5), st.integers(0, 2))
def test_peak_to_peak_of_a_sine_is_twice_its_amplitude_along_its_axis(amplitude, frequency, axis):
    """Whole periods in the last 3 s, before which the tip was far away; the sum of two axes would be more."""
    tips = np.zeros((501, 3))
    tips[:, axis] = 7.0 + amplitude * np.cos(2 * np.pi * frequency * TIME)
    tips[:, axis - 1] = 0.5 * amplitude * np.sin(2 * np.pi * frequency * TIME)
    tips[:349] = -5.0
    peak = abs(np.cos(2 * np.pi * frequency * TIME[350:])).max()
    low = np.cos(2 * np.pi * frequency * TIME[350:]).min()
    assert peak_to_peak(tips, PERIOD) == pytest.approx(amplitude * (peak - low), rel=1e-9)
    assert peak_to_peak(tips, PERIOD) == pytest.approx(2 * amplitude, rel=0.03)


def test_peak_to_peak_takes_the_window_with_both_ends_and_what_there_is():
    tips = np.zeros((501, 3))
    tips[350, 1] = 0.3  # exactly 3 s before the end
    assert peak_to_peak(tips, PERIOD) == 0.3
    tips[350, 1], tips[349, 1] = 0.0, 0.3
    assert peak_to_peak(tips, PERIOD) == 0.0 and peak_to_peak(tips, PERIOD, 3.02) == 0.3
    assert peak_to_peak(np.array([[0.0, 0, 0], [0, 0, 1]]), PERIOD) == 1.0


def test_the_final_error_is_the_median_of_the_last_second():
    errors = np.full(501, 100.0)
    errors[450:] = np.arange(51)
    assert final_error(errors, PERIOD) == 25.0
    assert final_error(np.array([4.0]), PERIOD) == 4.0


def test_effort_is_the_mean_square_of_all_actions():
    assert effort(np.array([[1.0, 0.0], [0.0, -1.0]])) == 0.5
    assert effort(np.full((7, 3), -0.5)) == 0.25


# The median and its interval


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


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: stabilisation_time(np.zeros(0), 0.02, 0.1), "errors: array([], dtype=float64) is not allowed; give"),
        (lambda: stabilisation_time(np.zeros((2, 2)), 0.02, 0.1), "errors: array([[0., 0.], [0., 0.]]) is not"),
        (lambda: stabilisation_time(np.zeros(9), 0.0, 0.1), "band: 0.0 is not allowed; give a finite number > 0 (m)"),
        (lambda: stabilisation_time(np.zeros(9), 0.1, -1.0), "period: -1.0 is not allowed; give a finite number > 0"),
        (lambda: peak_to_peak(np.zeros(9), 0.1), "tips: array([0., 0., 0., 0., 0., 0., 0., 0., 0.]) is not allowed"),
        (lambda: peak_to_peak(np.zeros((9, 3)), 0.1, 0.0), "window: 0.0 is not allowed; give a finite number > 0 (s)"),
        (lambda: final_error(np.zeros(9), 0.0), "period: 0.0 is not allowed; give a finite number > 0 (s)"),
        (lambda: effort(np.zeros((0, 3))), "actions: array([], shape=(0, 3), dtype=float64) is not allowed; give an"),
        (lambda: median_interval(np.zeros(0)), "values: array([], dtype=float64) is not allowed; give an array of 1"),
    ],
)
def test_bad_arrays_and_times_are_refused_in_one_line(call, line):
    assert refusal(call).startswith(line)
