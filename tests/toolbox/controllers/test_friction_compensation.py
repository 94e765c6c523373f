"""Friction compensation of control laws, one control period ahead."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.controller import Plant
from flexman_gym.model.friction import frictionless
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.friction_compensation import COMPENSATION_FACTOR, FrictionCompensation

from oracles.frictional import two_links as model

PERIOD, LIMITS = 0.02, (12.0, 4.0)


def plant(own):
    return Plant(own, LIMITS, PERIOD, dict)


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
