"""Reference: the minimum-jerk motion is the published one, and a planned slew keeps to the torque limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.control.reference import GiveWay, Path, minimum_jerk, plan_path, plan_slew
from flexman_gym.envs.catalog import NAMED
from flexman_gym.envs.setup import build, setup_of
from flexman_gym.model.instant import inertial_forces, stiffness_matrix

from oracles.chains import QUICK
from oracles.refusals import refusal

PERIOD, SHARE = 0.02, 0.95
parts = st.floats(0.0, 1.0)


def rigid():
    """A rigid link on a rigid joint: one number of inertia."""
    link = fm.Link(1.0, 1e-3, 1e-7, 1e-7, 2e-7, youngs_modulus=70e9, shear_modulus=26e9, density=2000.0)
    return fm.build_model(fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0), 0.3)]), 1, flexible_links=False)


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
    before, after = minimum_jerk(np.clip(part - h, 0, 1)), minimum_jerk(np.clip(part + h, 0, 1))
    width = min(part + h, 1) - max(part - h, 0)
    for slope in (0, 1):
        result = (after[slope] - before[slope]) / width
        assert result == pytest.approx(minimum_jerk(np.array(part))[slope + 1], abs=1e-3)


@settings(QUICK, max_examples=20)
@given(st.floats(0.1, 3.0), st.floats(0.5, 50.0))
def test_the_slew_of_a_rigid_link_takes_the_time_of_its_closed_form(way, limit):
    """Inertia times peak acceleration, 5.76 way / T^2 where it is sampled, takes its share of the limit."""
    model = rigid()
    slew = plan_slew(model, np.zeros(1), np.array([way]), np.array([limit]), SHARE, PERIOD)
    inertia = fm.mass_matrix(model, np.zeros(2))[0, 0]
    shortest = np.sqrt(5.76 * inertia * way / (SHARE * limit))
    assert len(slew.torques) == max(1, np.ceil(shortest / PERIOD - 1e-6))
    duration = PERIOD * len(slew.torques)
    middles = (np.arange(len(slew.torques)) + 0.5) / len(slew.torques)
    expected = inertia * way / duration**2 * minimum_jerk(middles)[2]
    assert slew.torques[:, 0] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert slew.states[:, 0] == pytest.approx(way * minimum_jerk(np.linspace(0, 1, len(slew.states)))[0], abs=1e-12)


@pytest.mark.parametrize("name", sorted(NAMED))
def test_a_slew_keeps_to_its_share_of_the_limits_and_takes_all_of_it(name):
    setup = setup_of({"name": name})
    model, limits, rng = build(setup).model, np.array(setup.torque_limit), np.random.default_rng(1)
    for _ in range(3):
        start, goal = rng.uniform(-0.8, 0.8, (2, model.n_joints))
        slew = plan_slew(model, start, goal, limits, SHARE, setup.control_period)
        assert slew.states[0] == pytest.approx(fm.rest_state(model, start), abs=1e-12)
        assert slew.states[-1] == pytest.approx(fm.rest_state(model, goal), abs=1e-12)
        assert np.abs(slew.torques / limits).max() <= 1.01 * SHARE
        path, duration = Path(model, start, goal), setup.control_period * len(slew.torques)
        assert path.peak(duration, limits) <= SHARE < path.peak(duration - setup.control_period, limits)
        assert slew.states.shape == (len(slew.torques) + 1, 2 * model.n_dof)


@pytest.mark.parametrize("name", ["FlexOne-v0", "FlexPlanar-v0", "FlexRRR-v0"])
def test_links_on_the_way_are_bent_as_far_as_inertia_and_weight_ask(name):
    """Their elastic forces balance what the motion demands of the bent arm, to a ten-thousandth of it."""
    setup = setup_of({"name": name})
    model, limits, random = build(setup).model, np.array(setup.torque_limit), np.random.default_rng(1)
    start, goal = random.uniform(-0.8, 0.8, (2, model.n_joints))
    duration = setup.control_period * len(plan_slew(model, start, goal, limits, SHARE, setup.control_period).torques)
    n, path, elastic = model.n_joints, Path(model, start, goal), slice(model.n_joints + model.n_motors, model.n_dof)
    way = (fm.rest_state(model, goal) - fm.rest_state(model, start))[:n]
    for part in np.linspace(0.0, 1.0, 9):
        _, speed, change = minimum_jerk(np.array(part))
        rates, changes = np.zeros((2, model.n_dof))
        rates[:n] = rates[model.motor_columns] = speed / duration * way
        changes[:n] = changes[model.motor_columns] = change / duration**2 * way
        x, torques = path.at(part, duration)
        demand, restoring = inertial_forces(model)(x, rates, changes), stiffness_matrix(model) @ x
        assert np.abs(demand + restoring)[elastic].max() <= 1e-4 * np.abs(demand[elastic]).max() + 1e-12
        balance = (demand + restoring)[model.motor_columns]
        assert torques == pytest.approx(balance, abs=1e-3 * np.abs(limits).max())


def test_a_slow_slew_is_a_sequence_of_places_of_rest():
    setup = setup_of({"name": "FlexPlanar-v0"})
    model = build(setup).model
    start, goal = np.array([-0.5, 0.2]), np.array([0.6, -0.4])
    path = Path(model, start, goal)
    first, last = (fm.rest_state(model, posture)[:2] for posture in (start, goal))
    for part in (0.0, 0.3, 1.0):
        x, torques = path.at(part, 1e4)
        joints = first + float(minimum_jerk(np.array(part))[0]) * (last - first)
        rest = fm.rest_state(model, x[model.motor_columns])
        assert x[:2] == pytest.approx(joints) and x == pytest.approx(rest[: model.n_dof], abs=1e-4)
        assert torques == pytest.approx(fm.holding_torques(model, x[model.motor_columns]), abs=0.05)


def test_a_goal_whose_weight_is_too_much_is_refused_in_one_line():
    setup = setup_of({"name": "FlexPlanar-v0"})
    arguments = build(setup).model, np.array([np.pi / 2, 0.0]), np.zeros(2), np.array([3.0, 1.0]), SHARE, 0.01
    line = refusal(plan_slew, *arguments)
    assert line == "goal: [0.0, 0.0] is not allowed; give a posture that 95% of the torque limits can hold"


def test_the_torques_of_a_path_are_those_of_the_middle_of_each_period():
    """A rigid link on a minimum-jerk path: inertia times the acceleration then, as splines have it."""
    model, periods, duration = rigid(), 200, 2.0
    period = duration / periods
    path = minimum_jerk(np.linspace(0.0, 1.0, periods + 1))[0][:, None]
    slew = plan_path(model, path, period)
    inertia = fm.mass_matrix(model, np.zeros(2))[0, 0]
    middles = (np.arange(periods) + 0.5) / periods
    expected = inertia / duration**2 * minimum_jerk(middles)[2]
    assert np.abs(slew.torques[:, 0] - expected)[20:-20].max() < 2e-3 * np.abs(expected).max()


def test_joints_do_not_turn_far_for_what_an_outstretched_arm_cannot_reach():
    """The least turn that closes the gap across the arm; that along it would take tens of radians, to first order."""
    arm = fm.catalog.planar_2r()
    model, (first, second) = fm.build_model(arm, flexible_links=False), (link.length for link in arm.links)
    rest, place = (fm.rest_state(model, np.array([0.0, elbow]))[: model.n_dof] for elbow in (0.3, 1e-3))
    slopes, across = np.array([first + second, second]), second * (np.sin(0.3) - np.sin(1e-3))
    assert GiveWay(model).turn(rest, place) == pytest.approx(across * slopes / (slopes @ slopes), rel=5e-3)
