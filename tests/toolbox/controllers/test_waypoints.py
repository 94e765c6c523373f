"""Tests of waypoints: the curve through points of a polynomial is this polynomial, and nothing is filled in silence."""

import numpy as np
import pytest

from flexman_gym.toolbox.controllers.input_shaping.waypoints import Waypoints

from oracles.assertions import refusal

QUINTIC = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])  # at rest at 0 and 1, without acceleration
CUBIC = np.polynomial.Polynomial([0.0, 0.0, 3.0, -2.0])  # at rest at 0 and 1
UNEVEN = np.array([0.0, 0.08, 0.2, 0.3, 0.43, 0.5, 0.6, 0.75, 0.8, 0.9, 1.0])
SHORT_END = np.append(0.1 * np.arange(10), 0.957)


def samples(curve, times, orders=3):
    """Derivatives (3, T, 2) of two joints, NaN from `orders` on."""
    values = np.full((3, len(times), 2), np.nan)
    for order in range(orders):
        part = curve.deriv(order)(times) if order else curve(times)
        values[order] = np.column_stack([part, -0.5 * part])
    return values


def stretched(curve, times):
    """The curve with its end at the last of the times."""
    return curve(np.polynomial.Polynomial([0.0, 1.0 / times[-1]]))


@pytest.mark.parametrize(("curve", "orders"), [(QUINTIC, 3), (CUBIC, 2)])
@pytest.mark.parametrize("rate", [None, 40.0, 1000.0])
def test_unequal_steps_are_resampled_along_the_polynomial(curve, orders, rate):
    points = Waypoints.of("a", UNEVEN, samples(curve, UNEVEN, orders))
    period, values, notes = points.sampled(tuple(range(orders)), rate)
    assert period == pytest.approx(1.0 / rate if rate else np.median(np.diff(UNEVEN)))
    times = np.minimum(period * np.arange(values.shape[1]), 1.0)
    inside = period * np.arange(values.shape[1]) <= 1.0
    expected = samples(curve, times, orders)[:orders]
    assert values[:, inside] == pytest.approx(expected[:, inside], abs=1e-11)
    assert values[0, -1] == pytest.approx([1.0, -0.5], abs=1e-12) and values[1, -1] == pytest.approx(
        [0.0, 0.0], abs=1e-11
    )
    assert notes[0].startswith("11 points in steps of 50 ms to 150 ms are sampled at steps of ")


def test_positions_at_given_times_are_reproduced_whatever_is_known():
    for orders in (1, 2, 3):
        values = samples(QUINTIC, UNEVEN, orders)
        found = Waypoints.of("a", UNEVEN, values).curve((0,), UNEVEN)[0]
        assert found == pytest.approx(values[0], abs=1e-14)


def test_a_shorter_last_step_ends_in_rest_at_the_next_sample():
    curve = stretched(QUINTIC, SHORT_END)
    period, values, notes = Waypoints.of("a", SHORT_END, samples(curve, SHORT_END)).sampled((0, 1, 2), None)
    assert period == pytest.approx(0.1) and values.shape == (3, 11, 2)
    assert values[:, :10] == pytest.approx(samples(curve, SHORT_END[:10]), abs=1e-12)
    assert values[0, 10] == pytest.approx([1.0, -0.5]) and not values[1:, 10].any()
    assert notes[0].endswith("by their velocities and accelerations, to 1 s in place of 0.957 s")


def test_equal_steps_are_kept_to_the_bit():
    times = 0.05 * np.arange(21)
    values = samples(QUINTIC, times)
    period, found, notes = Waypoints.of("a", times, values.copy()).sampled((0, 1, 2), None)
    assert np.array_equal(found, values) and not notes and period == pytest.approx(0.05)
    assert Waypoints.of("a", times, values.copy()).sampled((0, 1, 2), 20.0)[2] == ()


def test_positions_alone_follow_a_spline_with_an_error_of_the_fourth_order():
    errors = []
    for count in (20, 40):
        part = np.arange(count + 1) / count
        times = part + 0.2 * np.sin(2.0 * np.pi * part) / (2.0 * np.pi)
        fine = np.linspace(0.0, 1.0, 501)
        found = Waypoints.of("a", times, samples(QUINTIC, times, 1)).curve((0,), fine)[0, :, 0]
        errors.append(np.abs(found - QUINTIC(fine)).max())
    assert errors[1] < errors[0] / 10.0


@pytest.mark.parametrize(("row", "end"), [(0, "first"), (-1, "last")])
def test_a_bare_point_at_an_end_is_one_of_rest_and_told(row, end):
    values = samples(QUINTIC, UNEVEN)
    values[1:, row] = np.nan
    points = Waypoints.of("a", UNEVEN, values)
    assert points.notes == (
        f"velocities of the {end} line are missing: taken as 0",
        "accelerations of 1 line(s) are missing: those of the curve",
    )
    found = points.sampled((0, 1, 2), 100.0)[1]
    assert np.isfinite(found).all() and np.abs(found[0, :, 0] - QUINTIC(0.01 * np.arange(101))).max() < 1e-4


def test_missing_velocities_within_are_those_of_a_spline_and_told():
    values = samples(CUBIC, UNEVEN, 2)
    values[1, 3:5] = np.nan
    points = Waypoints.of("a", UNEVEN, values)
    assert points.notes == ("velocities of 2 line(s) are missing: those of a cubic spline",)
    fine = np.linspace(0.0, 1.0, 101)
    assert points.curve((0,), fine)[0, :, 0] == pytest.approx(CUBIC(fine), abs=1e-12), "a cubic is its own spline"


def test_velocities_that_are_all_zero_in_a_motion_are_not_used_and_told():
    """With them the motion would stop at each point."""
    values = samples(CUBIC, UNEVEN, 2)
    values[1] = 0.0
    points = Waypoints.of("a", UNEVEN, values)
    assert points.notes == ("velocities are all zero: not used",)
    assert points.curve((1,), np.array([0.5]))[0, 0, 0] == pytest.approx(1.5)


def test_a_repeated_point_is_left_out_and_keeps_what_is_known_of_it():
    times = np.append(UNEVEN, 1.0)
    values = samples(QUINTIC, times)
    values[1:, -2] = np.nan
    points = Waypoints.of("a", times, values)
    assert points.notes == ("line 12 repeats the one before: left out",) and not np.isnan(points.values).any()
    values = samples(QUINTIC, times)
    values[0, -1] += 0.1
    assert refusal(Waypoints.of, "a", times, values) == "a: time: '1 after 1 s' is not allowed; give increasing times"


def test_a_rest_after_the_motion_is_kept():
    times = np.append(UNEVEN, 1.3)
    values = samples(QUINTIC, np.append(UNEVEN, 1.0))
    found = Waypoints.of("a", times, values).sampled((0, 1), 100.0)[1]
    assert found[0, 100:] == pytest.approx(np.tile([1.0, -0.5], (31, 1)), abs=1e-12)


@pytest.mark.parametrize("orders", [1, 2])
@pytest.mark.parametrize("is_bare", [False, True])
def test_motions_that_are_cut_off_are_refused(orders, is_bare):
    values = samples(QUINTIC, UNEVEN[:6], orders)
    if is_bare:
        values[1, -1] = np.nan
    line = refusal(Waypoints.of, "a", UNEVEN[:6], values)
    assert line.startswith("a: the speed at the end: '") and line.endswith("otherwise its ends set the vibration")


def test_too_many_samples_are_refused_with_the_largest_rate():
    points = Waypoints.of("a", UNEVEN, samples(QUINTIC, UNEVEN))
    assert refusal(points.sampled, (0,), 1e9) == "rate: '1e+09 Hz' is not allowed; give at most 1e+06 Hz (--rate)"
