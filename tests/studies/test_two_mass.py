"""Tests of the benchmark of two masses: frequency, linear loops against the simulation, and known loops."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.model.state_space import LinearModel
from flexman_gym.simulation.batch import Batch
from studies.verification.two_mass import (
    AGENTS,
    DESIGNS,
    ENVIRONMENT,
    WEIGHTS,
    TwoMassLoop,
    closed_loop,
    impulse_response,
    make_loop,
    measure_loop,
    two_mass_table,
)

PERIOD = 0.02  # s
NO_TORQUE = TwoMassLoop(LinearModel(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1))), PERIOD)


@pytest.mark.parametrize("stiffness", [0.5, 1.0, 2.0])
def test_frequency_of_two_masses(stiffness):
    found = 2.0 * np.pi * fm.frequencies(fm.build_model(fm.catalog.two_mass(stiffness)))
    assert found == pytest.approx([0.0, np.sqrt(2.0 * stiffness)], rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("stiffness", [0.5, 2.0])
def test_an_impulse_without_torque_has_a_closed_form(stiffness):
    """Mass 2 moves as t / 2 + sin(w t) / (2 w) with w = sqrt(2 k)."""
    position, torque = impulse_response(NO_TORQUE, stiffness).T
    times, rate = PERIOD * np.arange(len(position)), np.sqrt(2.0 * stiffness)
    np.testing.assert_allclose(position, times / 2.0 + np.sin(rate * times) / (2.0 * rate), atol=1e-9)
    assert not torque.any()


def simulated(agent, environment, stiffness, periods):
    """Return positions of mass 2 and torques (T, 2) of the simulated arm with an agent, after the impulse."""
    setup = Configuration.find(environment)
    model = resolve_fidelity(setup).model
    controller = make_base(agent, make_plant(setup, model))
    batch, only = Batch(model, setup.method, PERIOD / 20.0, PERIOD, arms=1), np.array([0])
    batch.vary(only, joint_stiffness=np.array([[stiffness]]))
    batch.reset(only, np.array([[0.0, 0.0, 1.0, 1.0 * (model.motor_columns[0] == 0)]]))
    controller.reset(only, EpisodeInfo(np.zeros((1, 1)), np.zeros((1, 1)), PERIOD), 1)
    applied, result = np.zeros((1, 1)), []
    for _ in range(periods):
        applied = controller.act({"joint_angles": batch.state[:, :1].copy()}, applied, np.array([True]))
        result.append([batch.state[0, 0], applied[0, 0]])
        batch.step(np.pad(applied, ((0, 0), (0, 6))))
    return np.array(result)


@pytest.mark.parametrize("stiffness", [0.7, 1.6])
@pytest.mark.parametrize("agent", [name for name in AGENTS if "by hand" in name])
def test_linear_loops_are_those_of_the_simulated_agents(agent, stiffness):
    loop = make_loop(AGENTS[agent], ENVIRONMENT + "/stiffness")
    expected, found = (
        impulse_response(loop, stiffness),
        simulated(AGENTS[agent], ENVIRONMENT + "/stiffness", stiffness, 500),
    )
    before = np.argmax(np.abs(np.append(expected[:500, 1], 9.0)) >= 1.0)  # periods before the first saturated one
    assert before > 150
    np.testing.assert_allclose(found[:before], expected[:before], atol=1e-4)


def test_only_the_link_is_measured():
    setup = Configuration.find(ENVIRONMENT)
    plant = make_plant(setup, resolve_fidelity(setup).model)
    assert [make_base(name, plant).sensors for name in ("lqg", "hinf")] == [("link_encoders",)] * 2
    observation, _ = gym.make(ENVIRONMENT).reset(seed=0, options={"start": [0.3]})
    assert observation[0] == pytest.approx(0.3)
    assert not plant.measured()["joint_angles"][1:].any()


def test_link_encoders_alone_need_an_arm_without_gravity():
    setup = Configuration("FlexRRR-Gravity-v0")
    plant = make_plant(setup, resolve_fidelity(setup).model)
    with pytest.raises(ValueError, match="motor_encoders with them"):
        make_base({"kind": "lqg", "sensors": ["link_encoders"]}, plant)


def test_the_design_for_the_range_is_robust_and_known_loops_are_told_apart():
    robust = measure_loop("hinf", "", make_loop({"kind": "hinf", "weights": WEIGHTS}, DESIGNS["0.5 to 2"]), 40)
    nominal = measure_loop("hinf", "", make_loop({"kind": "hinf", "weights": WEIGHTS}, DESIGNS["1"]), 40)
    assert robust.unstable < 0.2 < 0.5 < nominal.unstable
    assert robust.saturated == 0.0 and robust.torque < 1.0 and robust.settling < 15.0
    feedback = TwoMassLoop(replace(NO_TORQUE.controller, D=-0.1 * np.eye(1)), PERIOD)  # no damping: unstable
    assert np.abs(np.linalg.eigvals(closed_loop(feedback, 1.0)[0])).max() > 1.0
    assert "| 62 % (59 to 65) |" in two_mass_table([nominal]), "as if 62.5 % of all springs"
