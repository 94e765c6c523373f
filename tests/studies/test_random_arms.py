"""Tests of random arms: sizes, reproducibility, drives that hold the arm, and gains of a regulator."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.model.friction import frictionless
from flexman_gym.model.state_space import discretize
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.cost_weights import NamedWeights
from flexman_gym.toolbox.controllers.gain_table import POSTURE_SPACING
from studies.control.random_arms import MAX_REACH, MAX_SAG, MIN_REACH, random_arm, uncertain_environment


@pytest.mark.parametrize("seed", range(20))
def test_a_random_arm_has_the_documented_sizes(seed):
    arm = random_arm(seed)
    assert arm == random_arm(seed)
    assert 2 <= len(arm.links) <= 4
    assert MIN_REACH <= sum(link.length for link in arm.links) <= MAX_REACH


@pytest.mark.parametrize("seed", range(20))
def test_motors_hold_the_outstretched_arm_with_twice_its_payload(seed):
    arm = random_arm(seed)
    model = fm.build_model(arm, elements=1, flexible_links=False)
    loaded = fm.build_model(
        fm.Arm(arm.links, arm.joints, fm.Payload(2.0 * arm.payload.mass), gravity=arm.gravity), 1, flexible_links=False
    )
    torques = np.abs(fm.holding_torques(loaded, np.zeros(model.n_joints)))
    twists = torques / [joint.stiffness for joint in arm.joints]
    assert (torques <= [joint.torque_limit for joint in arm.joints]).all()
    assert (twists <= 1.001 * MAX_SAG).all()


def test_a_stiff_arm_under_gravity_has_a_stable_gain_where_the_balanced_riccati_equation_fails():
    settings = {**uncertain_environment(random_arm(6)), "control_period": 0.01}
    environment = Configuration("FlexRRR-v0", settings)
    model = varied_model(frictionless(resolve_fidelity(environment).model), payload_mass=0.0)
    period, posture = environment.control_period, POSTURE_SPACING * np.array([-7.0, -3.0, -17.0])
    rest, holding = fm.rest_state(model, posture), fm.holding_torques(model, posture)
    linear = fm.linearize(model, state=rest, torque=holding)
    limits = np.array([joint.torque_limit for joint in random_arm(6).joints])
    gain = NamedWeights.of_reach(model).gain(linear, model.motor_columns, limits, period)
    transition, inputs = discretize(linear.A, linear.B, period)
    assert np.abs(np.linalg.eigvals(transition - inputs @ gain)).max() < 1.0
