"""Reference trajectories: timings, time-optimal slews and paths."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.model.dynamics import inertial_forces, stiffness_matrix
from flexman_gym.toolbox.controllers.arm_scales import SlewBounds
from flexman_gym.toolbox.controllers.references.trajectories import (
    TIMINGS,
    DeflectionCompensation,
    constant_jerk_timing,
    plan_path,
    plan_slew,
)

from oracles.assertions import refusal
from oracles.chains import QUICK

parts = st.floats(0.0, 1.0)
sizes = st.floats(-1.0, 1.0).map(lambda power: 10.0**power)
limits = st.tuples(sizes, sizes, sizes, sizes)  # way, speed, acceleration and jerk
DENSE = 4001


def test_the_motion_starts_and_ends_at_rest():
    position, speed, acceleration = TIMINGS["quintic"].at(np.array([-1.0, 0.0, 1.0, 2.0]))
    assert position.tolist() == [0.0, 0.0, 1.0, 1.0]
    assert speed.tolist() == acceleration.tolist() == [0.0] * 4


def test_its_peaks_are_the_published_ones():
    """Speed 15 / 8 half way; acceleration 10 / sqrt(3) at (3 - sqrt(3)) / 6 of the way (Flash and Hogan 1985)."""
    result = TIMINGS["quintic"].at(np.linspace(0.0, 1.0, 100_001))
    assert result[1].max() == pytest.approx(1.875, rel=1e-12) and result[1].argmax() == 50_000
    assert np.abs(result[2]).max() == pytest.approx(5.7735, rel=1e-5)
    assert result[2].argmax() == pytest.approx(1e5 * (3 - np.sqrt(3)) / 6, abs=1)


@given(parts)
def test_it_is_symmetric_and_each_is_the_slope_of_the_one_before(part):
    position, speed, acceleration = TIMINGS["quintic"].at(np.array([part, 1 - part]))
    assert position.sum() == pytest.approx(1.0) and speed[0] == pytest.approx(speed[1], abs=1e-12)
    assert acceleration[0] == pytest.approx(-acceleration[1], abs=1e-12)
    h = 1e-5
    before, after = (
        TIMINGS["quintic"].at(np.clip([part - h], 0, 1)),
        TIMINGS["quintic"].at(np.clip([part + h], 0, 1)),
    )
    width = min(part + h, 1) - max(part - h, 0)
    for slope in (0, 1):
        result = (after[slope] - before[slope]) / width
        assert result == pytest.approx(TIMINGS["quintic"].at(np.array([part]))[slope + 1], abs=1e-3)


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
    motion = constant_jerk_timing(*given)
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
    motion = constant_jerk_timing(way, speed, acceleration)
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
    for motion, bend in ((constant_jerk_timing(*given), jerk), (constant_jerk_timing(*given[:3]), np.inf)):
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
    sharp, straight = constant_jerk_timing(2.0, 0.7, 1.3, 1e9), constant_jerk_timing(2.0, 0.7, 1.3)
    times = np.linspace(0.0, straight.duration, 100)
    assert sharp.duration == pytest.approx(straight.duration, abs=1e-8)
    assert sharp.at(times)[0] == pytest.approx(straight.at(times)[0], abs=1e-8)


@pytest.mark.parametrize(("name", "phases", "peak"), [("trapezoid", 3, 4.5), ("double-s", 7, 6.125)])
def test_the_phases_of_the_laws_of_slews_last_as_long_as_each_other(name, phases, peak):
    law = TIMINGS[name]
    assert law.begins == pytest.approx(np.arange(phases) / phases) and law.duration == pytest.approx(1.0)
    assert law.at(np.ones(1))[0] == pytest.approx(1.0) and law.at(np.linspace(0, 1, 421))[2].max() == pytest.approx(
        peak
    )


def test_limits_that_are_none_are_refused_in_one_line():
    assert refusal(constant_jerk_timing, 0.0, 1.0, 1.0).startswith("distance: 0.0 is not allowed; give a")
    assert refusal(constant_jerk_timing, 1.0, -1.0, 1.0).startswith("speed: -1.0 is not allowed; give a")
    assert refusal(constant_jerk_timing, 1.0, 1.0, np.inf, 1.0).startswith("acceleration: inf is not allowed; give a")
    assert refusal(constant_jerk_timing, 1.0, 1.0, 1.0, np.nan).startswith("jerk: nan is not allowed; give a")


PERIOD, SHARE = 0.02, 0.95


def rigid():
    """A rigid link on a rigid joint: one number of inertia."""
    link = fm.Link(1.0, 1e-3, 1e-7, 1e-7, 2e-7, youngs_modulus=70e9, shear_modulus=26e9, density=2000.0)
    return fm.build_model(fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0), 0.3)]), 1, flexible_links=False)


@pytest.mark.slow
@pytest.mark.parametrize(("law", "peak"), [("quintic", 5.76), ("trapezoid", 4.5), ("double-s", 6.125)])
@settings(QUICK, max_examples=20)
@given(way=st.floats(0.1, 3.0), limit=st.floats(0.5, 50.0))
def test_the_slew_of_a_rigid_link_takes_the_time_of_its_closed_form(law, peak, way, limit):
    """Inertia times peak acceleration, peak times way / T^2 where it is sampled, takes its share of the limit."""
    model = rigid()
    slew = plan_slew(model, np.zeros(1), np.array([way]), SlewBounds(np.array([limit]), SHARE), PERIOD, law)
    inertia = fm.mass_matrix(model, np.zeros(2))[0, 0]
    shortest = np.sqrt(peak * inertia * way / (SHARE * limit))
    assert len(slew.torques) == max(1, np.ceil(shortest / PERIOD - 1e-6))
    duration = PERIOD * len(slew.torques)
    middles = (np.arange(len(slew.torques)) + 0.5) / len(slew.torques)
    expected = inertia * way / duration**2 * TIMINGS[law].at(middles)[2]
    assert slew.torques[:, 0] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    places = way * TIMINGS[law].at(np.linspace(0, 1, len(slew.states)))[0]
    assert slew.states[:, 0] == pytest.approx(places, abs=1e-12)


@pytest.mark.parametrize(("law", "peak"), [("quintic", 1.875), ("trapezoid", 1.5), ("double-s", 1.75)])
@pytest.mark.parametrize("way", [0.2, 2.0])
def test_a_slew_bounded_by_rates_takes_the_time_of_its_closed_form(law, peak, way):
    """Strong motors: peak speed of the law times way over the rate; the rates of the plan reach the bound."""
    bounds = SlewBounds(np.array([1e4]), SHARE, np.array([0.7]))
    slew = plan_slew(rigid(), np.zeros(1), np.array([way]), bounds, 0.005, law)
    assert len(slew.torques) == np.ceil(peak * way / 0.7 / 0.005 - 1e-6)
    assert 0.98 * 0.7 < np.abs(slew.states[:, 1]).max() <= 0.7 * (1.0 + 1e-9)


def test_the_slowest_joint_decides_a_slew_bounded_by_rates():
    """Motors that hold different weights at both ends turn by up to 2 % more or less than the links."""
    setup = Configuration.from_keywords({"name": "FlexPlanar-v0", "elements": 1, "modes": 1})
    model, way = resolve_fidelity(setup).model, np.array([0.3, -0.6])
    slews = [
        plan_slew(model, np.zeros(2), way, SlewBounds(np.full(2, 1e4), SHARE, np.array(rates)), 0.005)
        for rates in ((0.3, 3.0), (3.0, 0.3), (3.0, 3.0))
    ]
    durations = [0.005 * len(each.torques) for each in slews]
    assert durations == pytest.approx([1.875, 3.75, 0.375], rel=0.02)


@pytest.mark.parametrize("vibrations", [0.0, 0.7, 1.6])
def test_a_slew_of_strong_motors_takes_the_periods_of_the_first_mode(vibrations):
    """A rigid link on a spring, whose period with the motor held is known."""
    link = fm.Link.rigid(1.0, 1.0, (0.5, 0.0, 0.0), np.diag([0.0, 0.05, 0.05]).tolist())
    arm = fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0), 0.05, stiffness=400.0)])
    bounds = SlewBounds(np.array([1e6]), SHARE, vibrations=vibrations)
    slew = plan_slew(fm.build_model(arm, 1), np.zeros(1), np.array([0.5]), bounds, 0.001)
    expected = vibrations * 2.0 * np.pi * np.sqrt(0.3 / 400.0)
    shortest = 0.01 if vibrations == 0.0 else expected + 0.001
    assert expected <= 0.001 * len(slew.torques) <= shortest + 1e-9


@pytest.mark.parametrize("duration", [80.0, 900.0])
def test_a_slew_of_weak_motors_may_take_minutes(duration):
    """By the closed form of a rigid link."""
    model = rigid()
    inertia = fm.mass_matrix(model, np.zeros(2))[0, 0]
    limit = 5.76 * inertia / (SHARE * duration**2)
    slew = plan_slew(model, np.zeros(1), np.ones(1), SlewBounds(np.array([limit]), SHARE), 1.0)
    assert len(slew.torques) == pytest.approx(duration, abs=1.0)


def peak_share(path, duration, limits):
    """The largest torque of a path, friction included, as a part of the limits, where it is looked at."""
    torques = path.at(path.check_points, duration)[1] + path.friction(path.check_points, duration)
    return np.abs(torques / limits).max()


@pytest.mark.parametrize("law", TIMINGS)
@pytest.mark.parametrize(
    "name", sorted({*NAMED_ENVIRONMENTS} - {"FlexCrane-v0", "FlexGantry-v0"})
)  # motors at all joints
def test_a_slew_keeps_to_its_share_of_the_limits_and_takes_all_of_it(name, law):
    setup = Configuration.from_keywords({"name": name})
    model, limits, rng = resolve_fidelity(setup).model, np.array(setup.torque_limit), np.random.default_rng(1)
    for _ in range(2):
        start, goal = rng.uniform(-0.8, 0.8, (2, model.n_joints))
        slew = plan_slew(model, start, goal, SlewBounds(limits, SHARE), setup.control_period, law)
        assert slew.states[0] == pytest.approx(fm.rest_state(model, start), abs=1e-12)
        assert slew.states[-1] == pytest.approx(fm.rest_state(model, goal), abs=1e-12)
        assert np.abs(slew.torques / limits).max() <= 1.01 * SHARE
        duration = setup.control_period * len(slew.torques)
        assert peak_share(slew.path, duration, limits) <= SHARE
        assert peak_share(slew.path, duration - setup.control_period, limits) > SHARE
        assert slew.states.shape == (len(slew.torques) + 1, 2 * model.n_dof)


def test_a_slew_of_a_soft_arm_is_timed_as_it_bends():
    """A load that bends the links of this one takes a third more torque than those of a slow slew by 1 / T^2."""
    model = fm.build_model(fm.catalog.planar_2r(payload=fm.Payload(10.0)), 2)
    start, goal, limits = np.array([0.0, 1.2]), np.array([1.5, -1.2]), np.full(2, 20.0)
    slew = plan_slew(model, start, goal, SlewBounds(limits, SHARE), PERIOD)
    path, duration = slew.path, PERIOD * len(slew.torques)
    assert (60.0 / duration) ** 2 * peak_share(path, 60.0, limits) < 0.8 * SHARE
    assert peak_share(path, duration, limits) <= SHARE < peak_share(path, duration - PERIOD, limits)


@pytest.mark.parametrize("name", ["FlexOne-v0", "FlexPlanar-v0", "FlexRRR-v0"])
def test_links_on_the_way_are_bent_as_far_as_inertia_and_weight_ask(name):
    """Their elastic forces balance what the motion demands of the bent arm, to a ten-thousandth of it."""
    setup = Configuration.from_keywords({"name": name})
    model, limits, random = resolve_fidelity(setup).model, np.array(setup.torque_limit), np.random.default_rng(1)
    start, goal = random.uniform(-0.8, 0.8, (2, model.n_joints))
    slew = plan_slew(model, start, goal, SlewBounds(limits, SHARE), setup.control_period)
    path, duration = slew.path, setup.control_period * len(slew.torques)
    n, elastic = model.n_joints, slice(model.n_joints + model.n_motors, model.n_dof)
    way = (fm.rest_state(model, goal) - fm.rest_state(model, start))[:n]
    for part in np.linspace(0.0, 1.0, 9):
        _, speed, change = (each[0] for each in TIMINGS["quintic"].at(np.array([part])))
        rates, changes = np.zeros((2, model.n_dof))
        rates[:n] = rates[model.motor_columns] = speed / duration * way
        changes[:n] = changes[model.motor_columns] = change / duration**2 * way
        x, torques = (each[0] for each in path.at(np.array([part]), duration))
        demand, restoring = inertial_forces(model)(x, rates, changes), stiffness_matrix(model) @ x
        assert np.abs(demand + restoring)[elastic].max() <= 1e-4 * np.abs(demand[elastic]).max() + 1e-12
        balance = (demand + restoring)[model.motor_columns]
        assert torques == pytest.approx(balance, abs=1e-3 * np.abs(limits).max())


def test_a_slow_slew_is_a_sequence_of_places_of_rest():
    setup = Configuration.from_keywords({"name": "FlexPlanar-v0"})
    model = resolve_fidelity(setup).model
    start, goal = np.array([-0.5, 0.2]), np.array([0.6, -0.4])
    path = plan_slew(model, start, goal, SlewBounds(np.array(setup.torque_limit), SHARE), setup.control_period).path
    first, last = (fm.rest_state(model, posture)[:2] for posture in (start, goal))
    for part in (0.0, 0.3, 1.0):
        x, torques = (each[0] for each in path.at(np.array([part]), 1e4))
        joints = first + TIMINGS["quintic"].at(np.array([part]))[0] * (last - first)
        rest = fm.rest_state(model, x[model.motor_columns])
        assert x[:2] == pytest.approx(joints) and x == pytest.approx(rest[: model.n_dof], abs=1e-4)
        assert torques == pytest.approx(fm.holding_torques(model, x[model.motor_columns]), abs=0.05)


def test_a_goal_whose_weight_is_too_much_is_refused_in_one_line():
    setup = Configuration.from_keywords({"name": "FlexPlanar-v0"})
    arguments = (
        resolve_fidelity(setup).model,
        np.array([np.pi / 2, 0.0]),
        np.zeros(2),
        SlewBounds(np.array([3.0, 1.0]), SHARE),
        0.01,
    )
    line = refusal(plan_slew, *arguments)
    assert line == "goal: [0.0, 0.0] is not allowed; give a posture with holding torques below 95% of the torque limits"


def test_other_laws_are_refused_in_one_line():
    model, arguments = rigid(), (SlewBounds(np.ones(1), SHARE), PERIOD)
    line = refusal(plan_slew, model, np.zeros(1), np.ones(1), *arguments, "cubic")
    assert line == "timing: 'cubic' is not allowed; give one of time-optimal, quintic, trapezoid, double-s"


@pytest.mark.parametrize("name", ["planar_2r", "paper_rrr"])
def test_a_rigid_arm_is_fed_what_inverse_dynamics_asks(name):
    """Along a slew of each law, rotors and weight included."""
    arm = getattr(fm.catalog, name)()
    arm = replace(arm, gravity=(0.3, -0.2, -9.81), payload=fm.Payload(3.0))
    model = fm.build_model(arm, flexible_links=False, flexible_joints=False)
    postures, limits = np.random.default_rng(7).uniform(-0.8, 0.8, (2, model.n_joints)), np.full(model.n_joints, 8000.0)
    plans = [plan_slew(model, *postures, SlewBounds(limits, SHARE), PERIOD, law) for law in TIMINGS]
    for plan in plans:
        count = len(plan.torques)
        motion = plan.path.motion((np.arange(count) + 0.5) / count)
        scaled = zip(*(each / (PERIOD * count) ** order for order, each in enumerate(motion)), strict=True)
        expected = np.array([fm.inverse_dynamics(model, *each) for each in scaled])
        assert np.abs(plan.torques - expected).max() <= 1e-9 * limits[0]


def test_the_torques_of_a_path_are_those_of_the_middle_of_each_period():
    """A rigid link on a minimum-jerk path: inertia times the acceleration then, as splines have it."""
    model, periods, duration = rigid(), 200, 2.0
    period = duration / periods
    path = TIMINGS["quintic"].at(np.linspace(0.0, 1.0, periods + 1))[0][:, None]
    slew = plan_path(model, path, period)
    inertia = fm.mass_matrix(model, np.zeros(2))[0, 0]
    middles = (np.arange(periods) + 0.5) / periods
    expected = inertia / duration**2 * TIMINGS["quintic"].at(middles)[2]
    assert np.abs(slew.torques[:, 0] - expected)[20:-20].max() < 2e-3 * np.abs(expected).max()


def test_joints_do_not_turn_far_for_what_an_outstretched_arm_cannot_reach():
    """The least turn that closes the gap across the arm; that along it would take tens of radians, to first order."""
    arm = fm.catalog.planar_2r()
    model, (first, second) = fm.build_model(arm, flexible_links=False), (link.length for link in arm.links)
    rest, place = (fm.rest_state(model, np.array([0.0, elbow]))[: model.n_dof] for elbow in (0.3, 1e-3))
    slopes, across = np.array([first + second, second]), second * (np.sin(0.3) - np.sin(1e-3))
    assert DeflectionCompensation(model).rotation(rest, place) == pytest.approx(
        across * slopes / (slopes @ slopes), rel=5e-3
    )
