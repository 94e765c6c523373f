"""Statics: how an arm rests under gravity, and the torques that hold it there."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal, vector
from flexman_gym.kernels import outputs
from flexman_gym.kernels.layout import OUTPUTS, TIP, make_work
from flexman_gym.model.instant import inertial_forces, stiffness_matrix
from flexman_gym.model.model import Model, checked_model

ITERATIONS, ROUNDING = 100, 1e-12  # of a Newton iteration with the stiffness alone; of the largest coordinate


def rest_state(model: Model, motor_angles: Sequence[float] | Array) -> Array:
    """State (2 d,) of an arm that rests with its motors held at angles (n,) rad: bent by its weight, without speed.

    Without gravity the arm is undeformed. With it, springs and links balance the weight at the place that they have
    bent to; the iteration takes the stiffness for the slope of that balance.

    Raises:
        ValueError: for wrong angles, and for an arm too soft to find its rest so.
    """
    angles = vector("motor_angles", motor_angles, checked_model(model).n_joints, "rad")
    state = model.initial_state(angles)
    if not model.constants.gravity.any():
        return state
    x, rest, forces = state[: model.n_dof], np.zeros(model.n_dof), inertial_forces(model)
    free = np.setdiff1d(np.arange(model.n_dof), model.motor_columns)
    stiffness = stiffness_matrix(model)
    for _ in range(ITERATIONS):
        unbalanced = (forces(x, rest, rest) + stiffness @ x)[free]
        change = np.linalg.solve(stiffness[np.ix_(free, free)], unbalanced) if len(free) else np.zeros(0)
        x[free] -= change
        if np.abs(change).max(initial=0.0) <= ROUNDING * max(1.0, np.abs(x).max()):
            return state
    raise refusal("motor_angles", motor_angles, "an arm that its springs can hold under its weight")


def holding_torques(model: Model, motor_angles: Sequence[float] | Array) -> Array:
    """Motor torques (n,) in N m that hold an arm at rest with its motors at angles (n,) rad; zero without gravity.

    Raises:
        ValueError: as `rest_state`.
    """
    x, rest = rest_state(model, motor_angles)[: model.n_dof], np.zeros(model.n_dof)
    return (inertial_forces(model)(x, rest, rest) + stiffness_matrix(model) @ x)[model.motor_columns]


def rest_tips(model: Model, postures: Array) -> Array:
    """(r, 3) m: tips, base frame, of the arm at rest with its motors at angles (r, n) rad."""
    work, row, tips = make_work(model.constants), np.zeros(OUTPUTS), np.zeros((len(postures), 3))
    for tip, angles in zip(tips, postures, strict=True):
        state = rest_state(model, angles)
        outputs.observe(model.constants, work, state[: model.n_dof], state[model.n_dof :], row)
        tip[:] = row[TIP]
    return tips
