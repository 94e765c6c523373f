"""Timing: laws are the published ones, keep their limits at every time, and take the time of their closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexman_gym.control.timing import LAWS, double_s, minimum_jerk, trapezoid

from oracles.chains import QUICK
from oracles.refusals import refusal

parts = st.floats(0.0, 1.0)
sizes = st.floats(-1.0, 1.0).map(lambda power: 10.0**power)
limits = st.tuples(sizes, sizes, sizes, sizes)  # way, speed, acceleration and jerk
DENSE = 4001


def test_the_motion_starts_and_ends_at_rest():
    position, speed, acceleration = minimum_jerk(np.array([-1.0, 0.0, 1.0, 2.0]))
    assert position.tolist() == [0.0, 0.0, 1.0, 1.0]
    assert speed.tolist() == acceleration.tolist() == [0.0] * 4


def test_its_peaks_are_the_published_ones():
    """Speed 15 / 8 half way; acceleration 10 / sqrt(3) at (3 - sqrt(3)) / 6 of the way (Flash and Hogan 1985)."""
    result = minimum_jerk(np.linspace(0.0, 1.0, 100_001))
    assert result[1].max() == pytest.approx(1.875, rel=1e-12) and result[1].argmax() == 50_000
    assert np.abs(result[2]).max() == pytest.approx(5.7735, rel=1e-5)
    assert result[2].argmax() == pytest.approx(1e5 * (3 - np.sqrt(3)) / 6, abs=1)


@given(parts)
def test_it_is_symmetric_and_each_is_the_slope_of_the_one_before(part):
    position, speed, acceleration = minimum_jerk(np.array([part, 1 - part]))
    assert position.sum() == pytest.approx(1.0) and speed[0] == pytest.approx(speed[1], abs=1e-12)
    assert acceleration[0] == pytest.approx(-acceleration[1], abs=1e-12)
    h = 1e-5
    before, after = minimum_jerk(np.clip([part - h], 0, 1)), minimum_jerk(np.clip([part + h], 0, 1))
    width = min(part + h, 1) - max(part - h, 0)
    for slope in (0, 1):
        result = (after[slope] - before[slope]) / width
        assert result == pytest.approx(minimum_jerk(np.array([part]))[slope + 1], abs=1e-3)


def shortest(way, speed, acceleration, jerk):
    """Seconds from rest to rest (Biagiotti and Melchiorri 2008, equations 3.30 to 3.33)."""
    if speed * jerk >= acceleration**2:
        time, least = way / speed + speed / acceleration + acceleration / jerk, speed / acceleration
        reached = way / speed >= least + acceleration / jerk
    else:
        time = way / speed + 2.0 * np.sqrt(speed / jerk)
        reached = way / speed >= 2.0 * np.sqrt(speed / jerk)
    if reached:
        return time
    if way >= 2.0 * acceleration**3 / jerk**2:
        return acceleration / jerk + np.sqrt((acceleration / jerk) ** 2 + 4.0 * way / acceleration)
    return np.cbrt(32.0 * way / jerk)


@settings(QUICK, max_examples=100)
@given(limits)
def test_a_double_s_keeps_its_limits_and_takes_the_time_of_its_closed_form(given):
    way, speed, acceleration, jerk = given
    motion = double_s(*given)
    times = np.linspace(0.0, motion.duration, DENSE)
    place, rate, change = motion.at(times)
    assert motion.duration == pytest.approx(shortest(*given), rel=1e-12)
    assert place[[0, -1]] == pytest.approx([0.0, way], abs=1e-12 * way)
    assert rate[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-12 * speed)
    assert rate.min() >= -1e-12 * speed and rate.max() <= speed * (1.0 + 1e-12)
    assert np.abs(change).max() <= acceleration * (1.0 + 1e-12)
    steepest = np.abs(np.diff(change)).max() / times[1]
    assert steepest == pytest.approx(jerk, rel=1e-6), "what takes the least time has all of the jerk"


@settings(QUICK, max_examples=100)
@given(limits)
def test_a_trapezoid_keeps_its_limits_and_takes_the_time_of_its_closed_form(given):
    way, speed, acceleration, _ = given
    motion = trapezoid(way, speed, acceleration)
    times = np.linspace(0.0, motion.duration, DENSE)
    place, rate, change = motion.at(times)
    flat = way >= speed**2 / acceleration
    expected = way / speed + speed / acceleration if flat else 2.0 * np.sqrt(way / acceleration)
    assert motion.duration == pytest.approx(expected, rel=1e-12)
    assert place[[0, -1]] == pytest.approx([0.0, way], abs=1e-12 * way)
    assert rate.max() <= speed * (1.0 + 1e-12) and rate.min() >= -1e-12 * speed
    assert rate[DENSE // 2] == pytest.approx(speed if flat else np.sqrt(way * acceleration), rel=1e-12)
    assert change[1] == pytest.approx(acceleration) and change[-2] == pytest.approx(-acceleration)
    assert np.abs(change).max() <= acceleration * (1.0 + 1e-12)


@settings(QUICK)
@given(limits)
def test_speeds_and_accelerations_are_slopes_and_motions_rest_before_and_after(given):
    way, _, acceleration, jerk = given
    for motion, bend in ((double_s(*given), jerk), (trapezoid(*given[:3]), np.inf)):
        h = 1e-5 * motion.duration
        times = np.linspace(2.0 * h, motion.duration - 2.0 * h, 999)
        before, now, after = (motion.at(times + step) for step in (-h, 0.0, h))
        assert np.abs((after[0] - before[0]) / (2.0 * h) - now[1]).max() <= acceleration * h + 1e-9 * way / h
        slopes = np.abs((after[1] - before[1]) / (2.0 * h) - now[2])
        near = np.abs(times[:, None] - motion.begins).min(axis=1) <= h  # of a jump of a trapezoid
        assert slopes[~near].max() <= min(bend * h, 1e-6 * acceleration) + 1e-6 * acceleration
        place, rate, change = motion.at(np.array([-1.0, motion.duration + 1.0]))
        assert place == pytest.approx([0.0, way], abs=1e-12 * way)
        assert change.tolist() == [0.0, 0.0] and np.abs(rate).max() <= 1e-12 * acceleration * motion.duration


def test_a_double_s_of_any_jerk_is_a_trapezoid():
    sharp, straight = double_s(2.0, 0.7, 1.3, 1e9), trapezoid(2.0, 0.7, 1.3)
    times = np.linspace(0.0, straight.duration, 100)
    assert sharp.duration == pytest.approx(straight.duration, abs=1e-8)
    assert sharp.at(times)[0] == pytest.approx(straight.at(times)[0], abs=1e-8)


@pytest.mark.parametrize(("name", "phases", "peak"), [("trapezoid", 3, 4.5), ("double-s", 7, 6.125)])
def test_the_phases_of_the_laws_of_slews_last_as_long_as_each_other(name, phases, peak):
    law = LAWS[name]
    assert law.begins == pytest.approx(np.arange(phases) / phases) and law.duration == pytest.approx(1.0)
    assert law.at(np.ones(1))[0] == pytest.approx(1.0) and law.at(np.linspace(0, 1, 421))[2].max() == pytest.approx(
        peak
    )


def test_limits_that_are_none_are_refused_in_one_line():
    assert refusal(trapezoid, 0.0, 1.0, 1.0).startswith("way: 0.0 is not allowed; give a")
    assert refusal(trapezoid, 1.0, -1.0, 1.0).startswith("speed: -1.0 is not allowed; give a")
    assert refusal(double_s, 1.0, 1.0, np.inf, 1.0).startswith("acceleration: inf is not allowed; give a")
    assert refusal(double_s, 1.0, 1.0, 1.0, np.nan).startswith("jerk: nan is not allowed; give a")
