"""Friction compensation of control laws, one control period ahead."""

import importlib
import pkgutil
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym import agent
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import EpisodeInfo, Plant
from flexman_gym.agent.friction_compensation import (
    COMPENSATION_FACTOR,
    FrictionCompensation,
    friction_torques,
    frictionless,
    mean_friction_derivatives,
    mean_friction_torques,
)
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.specification import make_plant
from flexman_gym.evaluation.metrics import evaluate
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.linearization import linearize
from flexman_gym.toolbox import controllers
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.tracking import Tracking

PERIOD, LIMITS = 0.02, (12.0, 4.0)
RATES = st.floats(-8.0, 8.0)


def model(coulomb=0.6, viscous=0.3, rate=0.03, rigid=False):
    whole = fm.catalog.vertical_2r()
    friction = {"viscous_friction": viscous, "coulomb_friction": coulomb, "coulomb_rate": rate}
    joints = [replace(each, **friction) for each in whole.joints]
    flexible = {"flexible_links": not rigid, "flexible_joints": not rigid}
    return fm.build_model(replace(whole, joints=joints), 1, None if rigid else 1, **flexible)


def plant(own):
    return Plant(own, LIMITS, PERIOD, dict)


@example(before=0.0, after=1e-5, width=1e-3)
@given(before=RATES, after=RATES, width=st.floats(1e-3, 0.1))
def test_the_mean_friction_is_that_over_a_uniform_change_of_the_rate(before, after, width):
    coefficients = np.array([[0.4], [1.5]])
    knots = np.unique(np.clip(width * np.linspace(-40.0, 40.0, 4001), *sorted((before, after))))
    rates = np.unique(np.concatenate([[before, after], knots]))
    values, middle = 0.4 * rates + 1.5 * np.tanh(rates / width), 0.5 * (before + after)
    at_middle = 0.4 * middle + 1.5 * np.tanh(middle / width)  # the mean over a change that is small beside the width
    mean = np.trapezoid(values, rates) / np.ptp(rates) if np.ptp(rates) > 1e-5 else at_middle
    found = mean_friction_torques(coefficients, np.array([before]), np.array([after]), width)
    assert found == pytest.approx(mean, abs=1e-3)


@pytest.mark.parametrize("change", [0.0, 1e-4, 4e-3, 6e-3, 0.3, -2.0])
def test_derivatives_of_the_mean_friction_are_those_of_extrapolated_differences(change):
    """Below a hundredth of the width of the smoothed friction, 0.5 rad/s, they follow from a quadrature."""
    coefficients, width, first = np.array([[0.3], [2.0]]), np.array([0.5]), 0.4

    def torque(by_first, by_last):
        return mean_friction_torques(coefficients, first + by_first, first + change + by_last, width)

    def differences(step, unit):
        return (torque(*step * unit) - torque(*-step * unit)) / (2.0 * step)

    changes = np.array([[1.0, 0.0], [0.0, 1.0]])
    rates = (np.array([[first]]), changes[:, :1]), (np.array([[first + change]]), changes[:, 1:])
    exact = mean_friction_derivatives(coefficients, *rates, width)
    for unit, value in zip(changes, exact, strict=True):
        coarse, middle, fine = (differences(step, unit) for step in (0.04, 0.02, 0.01))
        best = (16.0 * (4.0 * fine - middle) - (4.0 * middle - coarse)) / 45.0
        np.testing.assert_allclose(value, best, rtol=1e-6)


def test_the_mean_over_a_change_of_sign_does_not_drive_a_motor_and_at_equal_rates_it_is_the_friction():
    own, c = model(viscous=0.0), np.array([[0.0, 0.0], [0.6, 0.6]])
    width, rate = own.constants.coulomb_rate, np.array([0.2, -0.01])
    assert mean_friction_torques(c, rate, -rate, width) == pytest.approx(0.0, abs=1e-12)
    assert mean_friction_torques(c, rate, rate, width) == pytest.approx(friction_torques(own, rate, c), rel=1e-12)
    assert mean_friction_torques(c, rate, rate + 2e-6, width) == pytest.approx(
        friction_torques(own, rate + 1e-6, c), rel=1e-6
    )


def moved(own, state, torques):
    """Motor rates (n,) after a control period."""
    batch = Batch(own, control_period=PERIOD)
    batch.reset(np.array([0]), state[None])
    drive = np.zeros((1, own.n_joints + 6))
    drive[0, : own.n_joints] = torques
    batch.step(drive)
    return batch.state[0, own.n_dof + own.motor_columns]


@pytest.mark.parametrize("rates", [(0.8, 0.5), (0.15, -0.25), (0.0, 0.0)])
def test_an_arm_whose_friction_is_compensated_moves_as_the_arm_without_friction(rates):
    """Rigid, so that its rates change uniformly; also if a motor changes its direction within the period."""
    own = model(rigid=True)
    slippery = frictionless(own)
    state, command = fm.rest_state(own, np.array([0.4, -0.3])), np.array([-6.0, 3.0])
    state[own.n_dof + own.motor_columns] = rates
    added = FrictionCompensation(plant(own))(command[None], state[None], np.array([0]), 1)
    wanted = moved(slippery, state, command)
    error = np.abs(moved(own, state, command + added[0] / COMPENSATION_FACTOR) - wanted)
    plain = np.abs(moved(own, state, command) - wanted)
    assert error.max() < 0.05 * plain.max() and np.abs(added).max() > 0.1


def test_friction_and_other_parameters_are_those_of_the_estimate():
    own = model()
    compensation, arms = FrictionCompensation(plant(own)), np.array([1])
    state = fm.rest_state(own, np.array([0.4, -0.3]))
    state[own.n_dof + own.motor_columns] = 0.8, -0.5
    commands = np.zeros((1, 2))
    estimated = {"coulomb_friction": np.array([[9.0, 9.0], [0.0, 0.0]]), "viscous_friction": np.zeros((2, 2))}
    assert not compensation(commands, state[None], arms, 2, estimated).any()
    light, heavy = (
        compensation(commands, state[None], arms, 2, {"payload_mass": np.array([0.0, mass])}) for mass in (0.0, 0.5)
    )
    assert np.abs(light - heavy).max() > 1e-4


def test_for_an_arm_without_friction_nothing_is_simulated():
    own = model(0.0, 0.0)
    compensation = FrictionCompensation(plant(own))
    assert compensation.model is own is frictionless(own)
    assert compensation(np.ones((1, 2)), np.zeros((1, 2 * own.n_dof)), np.array([0]), 1) == 0.0
    assert not compensation._models._batches


def test_the_tracking_law_compensates_at_the_state_at_which_its_torques_act():
    """The sum is cut at the limits."""
    own, arms, active = plant(model()), np.array([0]), np.array([True])
    law = Tracking(own)
    law.reset(arms, EpisodeInfo(np.array([[0.1, -0.3]]), np.array([[0.6, 0.4]]), PERIOD), 1)
    state = fm.rest_state(own.model, np.array([0.1, -0.3]))
    law.torques(Estimate(state[None], np.array([0]), {}), active)
    state[own.model.n_dof + own.model.motor_columns] = 0.05, -0.05
    seen = []
    compensation = law._compensation
    law._compensation = lambda *given: seen.append((given[0].copy(), given[1])) or compensation(*given)
    result = law.torques(Estimate(state[None], np.array([0]), {}), active)
    commands, states = seen[0]
    assert np.array_equal(states, state[None])
    wanted = commands + compensation(commands, states, arms, 1)
    assert (
        np.array_equal(result, np.clip(wanted, -np.array(LIMITS), np.array(LIMITS)))
        and np.abs(wanted - commands).max() > 0.1
    )


def test_no_control_law_is_designed_for_a_linear_model_with_friction(monkeypatch):
    """Linear models of all laws; those of margins and observers have sliding motors."""
    modules = [
        each.name
        for package in (agent, controllers)
        for each in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    ]
    users = [each for each in map(importlib.import_module, modules) if hasattr(each, "linearize")]
    assert {each.__name__.rpartition(".")[2] for each in users} >= {"lqr", "mpc", "margins"}
    used = []

    def watched(linearized, *arguments, **named):
        used.append((linearized, named))
        return linearize(linearized, *arguments, **named)

    for each in users:
        monkeypatch.setattr(each, "linearize", watched)
    setup = Configuration.from_keywords({"name": "FlexPlanar-v0", "arm": model().arm, "elements": 1, "modes": 1})
    own = make_plant(setup, resolve_fidelity(setup).model)._replace(unknown={"coulomb_friction_factor": (0.5, 1.5)})
    for name in ("lqr", "lqr-tracking", "mpc", "lqg", "adaptive-lqr", "privileged-lqr"):
        used.clear()
        law = make_base(name, own)
        for table in getattr(getattr(law, "law", None), "_gains", ()):
            table(np.array([0]), np.full((1, 2), 0.31), np.array([0.03]))
        if not hasattr(law, "law"):
            law.reset(np.array([0]), EpisodeInfo(np.zeros((1, 2)), np.array([[0.3, 0.2]]), PERIOD), 1)
        assert used, name
        for linearized, named in used:
            assert linearized is frictionless(linearized) and named.get("friction", "sliding") == "sliding", name


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e-6, 1.0, 1.5])
def test_it_settles_an_arm_with_less_and_with_more_friction_than_its_model(factor):
    """Friction that is given, far from that of the model."""
    friction = Configuration.find("FlexRRR-v0/friction").arm
    ranges = {"viscous_friction_factor": (factor, factor), "coulomb_friction_factor": (factor, factor)}
    setup = Configuration.from_keywords({"name": "FlexRRR-v0", "arm": friction, "randomisation": ranges})
    base = make_base("privileged-lqr", make_plant(setup, resolve_fidelity(setup).model))
    result = evaluate(base, setup, range(5000, 5003))
    assert result["settled"] == 1.0 and result["vibration"] < 0.012
