"""PD controller with joint-torque feedback."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import EpisodeInfo, Plant
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.model.friction import mean_friction_torques
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.toolbox.controllers.torque_feedback_pd import RIGID_RATE, TUNINGS, TorqueFeedbackPD

LIMITS, PERIOD, ONE, ON = (12.0, 4.0), 0.02, np.array([0]), np.ones(1, dtype=bool)
START, GOAL = np.array([[0.1, -0.3]]), np.array([[0.6, 0.4]])


def plant(gravity=False, payloads=None, delay=0, period=PERIOD, **joint):
    arm = fm.catalog.vertical_2r()
    joints = [replace(each, **joint) for each in arm.joints]
    arm = replace(arm, joints=joints, gravity=arm.gravity if gravity else (0.0, 0.0, 0.0))
    unknown = {"payload_mass": payloads} if payloads else {}
    return Plant(fm.build_model(arm, 1, 1), LIMITS, period, dict, unknown, (delay, delay))


def begun(own, start=START, goal=GOAL, **drawn):
    result = TorqueFeedbackPD(own)
    result.reset(ONE, EpisodeInfo(start, goal, PERIOD, drawn=drawn), 1)
    return result


def readings(errors=((0.0, 0.0),), rates=((0.0, 0.0),), twists=((0.0, 0.0),), **more):
    named = {"angle_errors": errors, "motor_rates": rates, "joint_twists": twists, **more}
    return {name: np.array(values) for name, values in named.items()}


def torques(controller, given):
    return controller.act(given, np.zeros((1, 2)), ON)[0] * LIMITS


def test_at_its_goal_it_is_a_pd_with_feedback_of_the_joint_torque():
    own = begun(plant(), GOAL)
    constants, tuning = plant().model.constants, TUNINGS[0]
    spring = torques(own, readings(twists=[[1e-3, -2e-3]]))
    assert spring == pytest.approx(tuning.feedback * constants.joint_stiffness * [1e-3, -2e-3])
    damping = own._damping
    assert torques(own, readings(rates=[[0.01, -0.01]])) == pytest.approx(damping * [-0.01, 0.01], rel=1e-6)
    assert torques(own, readings(goal_rates=[[0.01, -0.01]])) == pytest.approx(damping * [0.01, -0.01], rel=1e-6)
    assert torques(own, readings(errors=[[1e-3, 2e-3]])) == pytest.approx(own._stiffness[0] * [1e-3, 2e-3])


@pytest.mark.parametrize("period, bounded", [(0.05, False), (0.01, True), (0.001, True)])
def test_damping_stops_rotors_within_a_control_period_and_the_rigid_arm_within_the_time_of_a_slew(period, bounded):
    """Torque feedback f divides inertia J and damping D of the motors by 1 - f; links I; the smallest D / (J + I)."""
    given = plant(period=period)
    own, tuning, constants = TorqueFeedbackPD(given), TUNINGS[0], given.model.constants
    links = np.diag(fm.mass_matrix(given.model, np.zeros(2 * given.model.n_dof)))[:2]
    damping, rotors = (each / (1.0 - tuning.feedback) for each in (own._damping, constants.rotor_inertia))
    rate = (damping / (rotors + links)).min() * own._scales[0]
    assert (rate == pytest.approx(RIGID_RATE)) == bounded and rate < 1.0001 * RIGID_RATE
    assert (own._damping == pytest.approx(tuning.damping * constants.rotor_inertia / period)) == (not bounded)


def test_on_a_minimum_jerk_slew_it_feeds_the_acceleration_forward_and_at_its_end_it_rests():
    """Rotor inertia and duration by their closed forms; the slew begins at rest."""
    own, way = begun(plant()), (GOAL - START)[0]
    duration = own._scales[0] * np.sqrt(np.abs(way).max() + 0.05)
    for period in range(2 * round(duration / PERIOD)):
        s = min(period * PERIOD / duration, 1.0)
        place, speed = 10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
        acceleration = (60 * s - 180 * s**2 + 120 * s**3) / duration**2
        found = torques(own, readings(errors=[(1.0 - place) * way], rates=[speed * way]))
        assert found == pytest.approx(own._inertia[0] * acceleration * way, abs=1e-9)
    assert s == 1.0 and found == pytest.approx(0.0, abs=1e-9)


def test_a_heavier_class_of_payloads_takes_longer_and_classes_are_steps():
    scaled = plant(payloads=(0.0, 0.4))
    own = begun(scaled)
    assert (np.diff(own._scales) > 0).all() and len(own._scales) == 4
    found = [int(begun(scaled, payload_mass=np.array([mass]))._classes[0]) for mass in (0.0, 0.09, 0.11, 0.39)]
    assert found == [0, 0, 1, 3]


def test_under_gravity_an_arm_at_rest_at_its_goal_is_held():
    own = plant(gravity=True)
    rest, n = rest_state(own.model, GOAL[0]), 2
    twists = rest[own.model.motor_columns] - rest[:n]
    held = torques(begun(own, GOAL), readings(twists=[twists]))
    assert held == pytest.approx(holding_torques(own.model, GOAL[0]), rel=1e-6) and np.abs(held).max() > 0.1


def test_friction_is_added_as_of_the_motion_of_the_next_period():
    rates = [[0.3, -0.3]]
    smooth, rubbing = (begun(plant(**each), GOAL) for each in ({}, {"coulomb_friction": 0.2, "viscous_friction": 0.1}))
    added = torques(rubbing, readings(rates=rates)) - torques(smooth, readings(rates=rates))
    slowing = smooth._damping * PERIOD / plant().model.constants.rotor_inertia
    damped = np.array(rates[0]) * (1.0 - slowing)  # after a period under the damping alone
    expected = mean_friction_torques(rubbing._friction, np.array(rates[0]), damped, rubbing._width)
    assert added == pytest.approx(expected) and np.abs(added).max() > 0.01
    assert torques(rubbing, readings()) == pytest.approx(0.0, abs=1e-12)


def test_gains_of_a_longer_delay_are_smaller_and_those_of_the_longest_serve_beyond():
    damping = [TorqueFeedbackPD(plant(delay=delay))._damping[0] for delay in (0, 1, 2, 9)]
    assert damping[0] > damping[1] >= damping[2] == damping[3]


def test_it_settles_the_spatial_arm_without_a_model_of_it():
    result = evaluate("pd-torque", "FlexRRR-v0", range(5000, 5003))
    assert result["settled"] == 1.0 and result["failed"] == 0.0
    assert type(make_base("pd-torque", plant())) is TorqueFeedbackPD
