"""Settling times, overshoot and errors of signals with known results."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexman_gym.metrics import MOVE_BANDS, attained_distances, final_error, move_band, overshoot, settling_time

from oracles.assertions import refusal

PERIOD = 0.02
TIME = PERIOD * np.arange(501)  # 10 s


def test_a_tip_that_stands_still_on_its_target_has_stabilised_at_once():
    assert settling_time(np.zeros(501), 0.02, PERIOD) == 0.0
    assert settling_time(np.zeros(501), 0.02, PERIOD, since="entry") == 0.0
    assert overshoot(np.zeros(501), 0.02) == 0.0
    assert final_error(np.full(501, 0.3), PERIOD) == 0.3


@given(st.integers(0, 450), st.floats(0.001, 0.1))
def test_a_step_into_the_band_stabilises_at_its_first_sample_within(entry, band):
    errors = np.where(np.arange(501) < entry, 2 * band, band)  # on the edge is within
    assert settling_time(errors, band, PERIOD) == entry * PERIOD
    errors[-1] = 2 * band
    assert settling_time(errors, band, PERIOD) == np.inf


def test_a_decaying_vibration_stabilises_when_its_envelope_has_fallen_to_the_band():
    """|exp(-t) cos(50 pi t)|: a peak at every sample, so that the samples are the envelope."""
    errors = np.abs(np.exp(-TIME) * np.cos(50 * np.pi * TIME))
    expected = PERIOD * np.ceil(np.log(1 / 0.02) / PERIOD)
    assert settling_time(errors, 0.02, PERIOD) == pytest.approx(expected)


def test_only_who_stays_a_whole_second_has_stabilised():
    for last, expected in ((450, 9.0), (451, np.inf)):
        assert settling_time(np.where(np.arange(501) < last, 1.0, 0.0), 0.02, PERIOD) == expected
    assert settling_time(np.zeros(50), 0.02, PERIOD) == np.inf, "less than a second was seen"
    assert settling_time(np.zeros(51), 0.02, PERIOD) == 0.0


def test_an_error_that_is_no_number_is_outside_the_band():
    errors = np.zeros(501)
    errors[200] = np.nan
    assert settling_time(errors, 0.02, PERIOD) == pytest.approx(201 * PERIOD)
    errors[200] = np.inf
    assert settling_time(errors, 0.02, PERIOD) == pytest.approx(201 * PERIOD)


def test_the_final_error_is_the_median_of_the_last_second():
    errors = np.full(501, 100.0)
    errors[450:] = np.arange(51)
    assert final_error(errors, PERIOD) == 25.0
    assert final_error(np.array([4.0]), PERIOD) == 4.0


# From the first entry into the band


@given(st.integers(0, 150), st.integers(1, 100), st.integers(1, 200))
def test_since_the_entry_the_time_of_the_move_does_not_count(entry, inside, outside):
    """Into the band, out of it on the opposite side, and back until the end."""
    errors = np.full(501, 0.01)
    errors[:entry], errors[entry + inside : entry + inside + outside] = 1.0, 0.05
    last = entry + inside + outside
    assert settling_time(errors, 0.02, PERIOD) == pytest.approx(last * PERIOD)
    assert settling_time(errors, 0.02, PERIOD, since="entry") == pytest.approx((last - entry) * PERIOD)
    assert overshoot(errors, 0.02) == 0.05
    assert settling_time(errors, 0.06, PERIOD, since="entry") == 0.0 == overshoot(errors, 0.06)


def test_a_tip_that_never_enters_the_band_or_does_not_stay_has_no_settling_time():
    far, leaving = np.ones(501), np.where(np.arange(501) == 500, 1.0, 0.0)
    for since in ("start", "entry"):
        for errors in (far, leaving):
            assert settling_time(errors, 0.02, PERIOD, since) == np.inf
    assert overshoot(far, 0.02) == np.inf and overshoot(leaving, 0.02) == 1.0


@pytest.mark.parametrize("ratio", [0.05, 0.2, 0.5])
def test_the_overshoot_of_a_second_order_step_response_is_that_of_the_textbook(ratio):
    """exp(-pi z / sqrt(1 - z^2)) of the step, at half a period of the damped frequency."""
    period, rate = 1e-3, 2 * np.pi
    time, damped = period * np.arange(20_001), rate * np.sqrt(1 - ratio**2)
    swing = np.cos(damped * time) + ratio / np.sqrt(1 - ratio**2) * np.sin(damped * time)
    errors = np.abs(np.exp(-ratio * rate * time) * swing)
    expected = np.exp(-np.pi * ratio / np.sqrt(1 - ratio**2))
    assert overshoot(errors, 0.02) == pytest.approx(expected, rel=1e-4)
    assert overshoot(errors, 1.01 * expected) == 0.0, "it stays within a band that is as wide"
    first = np.flatnonzero(errors <= 0.02)[0] * period
    start, entry = (settling_time(errors, 0.02, period, since) for since in ("start", "entry"))
    assert 0.0 < entry == pytest.approx(start - first)
    assert errors[round(start / period) :].max() <= 0.02 < errors[round(start / period) - 1]


def test_an_overshoot_that_is_no_number_is_infinite():
    errors = np.where(np.arange(501) < 100, 1.0, 0.0)
    errors[200] = np.nan
    assert overshoot(errors, 0.02) == np.inf
    errors[200], errors[50] = 0.0, np.nan
    assert overshoot(errors, 0.02) == 0.0, "before the entry nothing counts"


def test_the_attained_position_is_where_the_tip_came_to_rest_not_its_target():
    """A tip at rest 0.1 m from its target overshoots by 0.3 m, not by 0.4 m."""
    tips = np.zeros((501, 3))
    tips[:100, 0], tips[100:, 1] = 2.0, 0.1
    tips[150:160, 1] = 0.4
    distances = attained_distances(tips, PERIOD)
    assert distances[0] == pytest.approx(np.hypot(2.0, 0.1)) and np.abs(distances[160:]).max() < 1e-15
    assert overshoot(distances, 0.02) == pytest.approx(0.3)
    tips[450:, 2] = np.where(np.arange(51) % 2, 0.01, -0.01)
    tips[450, 2] = 0.0
    assert attained_distances(tips, PERIOD)[451:] == pytest.approx(0.01)


def test_bands_of_a_move_are_parts_of_its_distance():
    errors = np.linspace(2.0, 0.0, 501)
    assert MOVE_BANDS == (0.01, 0.05)
    assert [move_band(errors, part) for part in MOVE_BANDS] == pytest.approx([0.02, 0.1])
    errors = 2.0 * np.exp(-TIME)
    result = [settling_time(errors, move_band(errors, part), PERIOD) for part in MOVE_BANDS]
    assert result == pytest.approx(PERIOD * np.ceil(-np.log(MOVE_BANDS) / PERIOD))


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: settling_time(np.zeros(0), 0.02, 0.1), "errors: array([], dtype=float64) is not allowed; give"),
        (lambda: settling_time(np.zeros((2, 2)), 0.02, 0.1), "errors: array([[0., 0.], [0., 0.]]) is not"),
        (lambda: settling_time(np.zeros(9), 0.0, 0.1), "band: 0.0 is not allowed; give a finite number > 0 (m)"),
        (lambda: settling_time(np.zeros(9), 0.1, -1.0), "period: -1.0 is not allowed; give a finite number > 0"),
        (lambda: settling_time(np.zeros(9), 0.1, 0.1, "end"), "since: 'end' is not allowed; give one of start"),
        (lambda: overshoot(np.zeros((2, 2)), 0.02), "errors: array([[0., 0.], [0., 0.]]) is not"),
        (lambda: overshoot(np.zeros(9), np.nan), "band: nan is not allowed; give a finite number > 0 (m)"),
        (lambda: attained_distances(np.zeros(9), 0.1), "tips: array([0., 0., 0., 0., 0., 0., 0., 0., 0.]) is not allo"),
        (lambda: attained_distances(np.full((2, 3), np.nan), 0.1), "tips: array([[nan, nan, nan], [nan, nan, nan]]) "),
        (lambda: attained_distances(np.zeros((2, 3)), 0.0), "period: 0.0 is not allowed; give a finite number > 0 (s)"),
        (lambda: move_band(np.zeros(9), 0.01), "errors[0]: 0.0 is not allowed; give a finite number > 0 (m)"),
        (lambda: move_band(np.ones(9), 5.0), "fraction: 5.0 is not allowed; give a number > 0 and < 1"),
        (lambda: final_error(np.zeros(9), 0.0), "period: 0.0 is not allowed; give a finite number > 0 (s)"),
    ],
)
def test_bad_arrays_and_times_are_refused_in_one_line(call, line):
    assert refusal(call).startswith(line)
