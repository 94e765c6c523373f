"""Statics: how an arm rests under gravity, and the torques that hold it there."""

from functools import lru_cache

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, Vector
from flexman_gym.common.checks import value_error, vector
from flexman_gym.kernels import inverse, outputs
from flexman_gym.kernels.layout import OUTPUTS, TIP, Work, make_work
from flexman_gym.model.dynamics import inertial_forces, stiffness_matrix
from flexman_gym.model.model import Model, check_model


def rest_states(model: Model, postures: Array) -> Array:
    """States (r, 2 d) of an arm at rest with its motors held at angles (r, n) rad: bent by its weight, without speed.

    Without gravity the arm is undeformed. With it, springs and links balance the weight at the place that they have
    bent to; the iteration takes the stiffness for the slope of that balance.

    Raises:
        ValueError: for an arm too soft to find its rest so.
    """
    states, d = model.at_rest(postures), model.n_dof
    if not model.constants.gravity.any():
        return states
    work, free, stiffness, compliance = _rest_system(model)
    rest, force = np.zeros(d), np.zeros(d)
    for posture, state in zip(postures, states, strict=True):
        change = inverse.solve_equilibrium(model.constants, work, stiffness, compliance, free, rest, state[:d], force)
        if not change <= inverse.EQUILIBRIUM_TOLERANCE:
            raise value_error("motor_angles", posture.tolist(), "an arm that its springs can hold under its weight")
    return states


def rest_state(model: Model, motor_angles: Vector) -> Array:
    """State (2 d,) of an arm that rests with its motors held at angles (n,) rad, see `rest_states`.

    Raises:
        ValueError: for wrong angles, and for an arm too soft to find its rest so.
    """
    angles = vector("motor_angles", motor_angles, check_model(model).n_joints, "rad")
    result: Array = rest_states(model, np.array([angles]))[0]
    return result


@lru_cache(maxsize=16)
def _rest_system(model: Model) -> tuple[Work, IntArray, Array, Array]:
    """Work space, coordinates that the motors do not hold, stiffness (d, d), and the inverse of its part of those.

    Kernels fill the work space anew in each call, during which no other thread runs.
    """
    free = np.setdiff1d(np.arange(model.n_dof), model.motor_columns)
    stiffness = stiffness_matrix(model)
    return make_work(model.constants), free, stiffness, np.linalg.inv(stiffness[np.ix_(free, free)])


def holding_torques(model: Model, motor_angles: Vector) -> Array:
    """Motor torques (n,) in N m that hold an arm at rest with its motors at angles (n,) rad; zero without gravity.

    Raises:
        ValueError: as `rest_state`.
    """
    x, rest = rest_state(model, motor_angles)[: model.n_dof], np.zeros(model.n_dof)
    return (inertial_forces(model)(x, rest, rest) + stiffness_matrix(model) @ x)[model.motor_columns]


def rest_tips(model: Model, postures: Array) -> Array:
    """(r, 3) m: tips, base frame, of the arm at rest with its motors at angles (r, n) rad."""
    work, row, tips = _rest_system(model)[0], np.zeros(OUTPUTS), np.zeros((len(postures), 3))
    for tip, state in zip(tips, rest_states(model, postures), strict=True):
        outputs.compute_outputs(model.constants, work, state[: model.n_dof], state[model.n_dof :], row)
        tip[:] = row[TIP]
    return tips
