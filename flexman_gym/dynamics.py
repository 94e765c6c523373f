"""Dynamics at an instant: accelerations, mass matrix and natural frequencies of a model at a state."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh

from flexman_gym.beam import Array
from flexman_gym.checks import vector
from flexman_gym.kernels import dynamics, inverse
from flexman_gym.kernels.layout import make_work
from flexman_gym.model import Model


def acceleration(model: Model, state: Sequence[float] | Array, torque: Sequence[float] | Array) -> Array:
    """Generalised accelerations (d,) at a state (2 d,) under motor torques (n,) in N m (Eq. 45 with Eq. 23).

    Raises ValueError for wrong shapes or values that are not finite.
    """
    x, v = _split(model, state)
    out = np.zeros(model.n_dof)
    motor_torque = np.array(vector("torque", torque, model.n_joints, "N m"))
    dynamics.accelerations(model.constants, make_work(model.constants), x, v, motor_torque, out)
    return out


def mass_matrix(model: Model, state: Sequence[float] | Array) -> Array:
    """Generalised mass matrix (d, d) at a state (2 d,), rotors included (Eq. 46 with Eq. 23).

    Raises ValueError for a wrong shape or values that are not finite.
    """
    x, _ = _split(model, state)
    weightless = model.constants._replace(gravity=np.zeros(3))
    work = make_work(weightless)
    matrix = np.zeros((model.n_dof, model.n_dof))
    for row, unit in zip(matrix, np.eye(model.n_dof), strict=True):
        inverse.inertial_forces(weightless, work, x, np.zeros(model.n_dof), unit, row)
    return (matrix + matrix.T) / 2


def stiffness_matrix(model: Model) -> Array:
    """Stiffness (d, d) of links and joint springs."""
    constants = model.constants
    matrix = np.zeros((model.n_dof, model.n_dof))
    for i, motor in enumerate(constants.motor):
        if motor >= 0:
            matrix[np.ix_([i, motor], [i, motor])] = constants.joint_stiffness[i] * np.array([[1, -1], [-1, 1]])
        columns = model.elastic_columns(i)
        block = constants.stiffness[constants.square_start[i] : constants.square_start[i + 1]]
        matrix[columns, columns] = block.reshape(columns.stop - columns.start, -1) if len(block) else 0.0
    return matrix


def frequencies(model: Model, joint_angles: Sequence[float] | None = None, lock_joints: bool = False) -> Array:
    """Undamped natural frequencies in Hz, ascending, of the unloaded arm at rest at joint angles (n,), zero by default.

    Free, there are d of them, the first n zero: the arm can turn about its joints. With `lock_joints` the motors (the
    joints where rigid) are clamped and the other d - n frequencies remain. Gravity is left out.

    Raises ValueError for wrong joint angles.
    """
    angles = np.zeros(model.n_joints) if joint_angles is None else joint_angles
    mass = mass_matrix(model, model.initial_state(angles))
    stiffness = stiffness_matrix(model)
    if lock_joints:
        free = np.setdiff1d(np.arange(model.n_dof), model.motor_columns)
        mass, stiffness = mass[np.ix_(free, free)], stiffness[np.ix_(free, free)]
    if len(mass) == 0:
        return np.zeros(0)
    squares = eigh(stiffness, mass, eigvals_only=True)
    if not lock_joints:
        squares[: model.n_joints] = 0.0  # rounding leaves their square roots at millihertz
    return np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)


def _split(model: Model, state: Sequence[float] | Array) -> tuple[Array, Array]:
    values = np.array(vector("state", state, 2 * model.n_dof))
    return values[: model.n_dof], values[model.n_dof :]
