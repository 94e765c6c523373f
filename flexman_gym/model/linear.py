"""Linear: the linear model of an arm about a state."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import refusal
from flexman_gym.model.element import NODE_COORDINATES
from flexman_gym.model.instant import (
    RICHARDSON,
    acceleration,
    damping_matrix,
    inertial_forces,
    mass_matrix,
    split_state,
    stiffness_matrix,
    tip_jacobian,
)
from flexman_gym.model.model import Model, checked_model
from flexman_gym.model.rounding import solvable

FIRST_STEP = 0.005  # rad, for a first derivative: its truncation is just below rounding


class LinearModel(NamedTuple):
    """The linear model x' = A x + B u, y = C x + D u for small departures from a state and its torques.

    The state x (2 d,) holds coordinates and speeds in the order of `kernels.layout`. The input u (n,) holds motor
    torques in N m. The output y (3,) is the tip in the base frame in m.

    Attributes:
        A: (2 d, 2 d).
        B: (2 d, n).
        C: (3, 2 d).
        D: (3, n), zero.
    """

    A: Array
    B: Array
    C: Array
    D: Array


def linearize(
    model: Model,
    joint_angles: Vector | None = None,
    state: Vector | None = None,
    torque: Vector | None = None,
) -> LinearModel:
    """Gives the linear model about the undeformed arm at rest, or about a whole state.

    Where the accelerations at the state do not vanish (gravity, speeds), x departs from the motion that starts there,
    and A is the slope at its start. Coulomb friction enters with its slope at the rates of the state, which is very
    steep at rest.

    The balance inertial forces + damping v + stiffness q = torques is differentiated term by term, so that stiff
    springs spoil nothing. Stiffness, damping, B and C are exact up to rounding. The slope by speeds is exact too, as
    the forces are quadratic in them.

    The slope of the inertial forces by coordinates is taken by central differences, extrapolated to order six. No step
    moves a section by more than 0.5 % of its link's length or 0.005 rad. On random chains, bent and fast, its measured
    error is 1e-12 of its largest entry. With the condition of the mass matrix on top, the error of A is 1e-10 of its
    largest entry (metres and radians weighed by their masses).

    Args:
        model: the model.
        joint_angles: (n,) rad, zero by default.
        state: (2 d,), in place of joint angles.
        torque: (n,) of the motors, N m, zero by default.

    Raises:
        ValueError: for wrong shapes, values that are not finite, or a state and joint angles at once.
    """
    from scipy.linalg import cho_factor, cho_solve

    checked_model(model)
    if state is None:
        state = model.initial_state(np.zeros(model.n_joints) if joint_angles is None else joint_angles)
    elif joint_angles is not None:
        raise refusal("state", "given with joint_angles", "one of the two")
    applied = np.zeros(model.n_joints) if torque is None else torque
    demands, d, n = _demands(model, state, applied), model.n_dof, model.n_joints
    mass = mass_matrix(model, state)
    scale = np.sqrt(np.diag(mass))  # metres and radians of fine elements weigh alike
    with solvable("accelerations"):
        factor = cho_factor(mass / np.outer(scale, scale))
        slopes = cho_solve(factor, demands / scale[:, None]) / scale[:, None]
    return LinearModel(
        A=np.block([[np.zeros((d, d)), np.eye(d)], [slopes[:, : 2 * d]]]),
        B=np.vstack([np.zeros((d, n)), slopes[:, 2 * d :]]),
        C=np.hstack([tip_jacobian(model, split_state(model, state)[0]), np.zeros((3, d))]),
        D=np.zeros((3, n)),
    )


def _demands(model: Model, state: Vector, torque: Vector) -> Array:
    """Gives slopes (d, 2 d + n), by coordinates, speeds and torques, of the forces that accelerate the arm."""
    (x, v), caused, forces = split_state(model, state), acceleration(model, state, torque), inertial_forces(model)
    d, n, size = model.n_dof, model.n_joints, coordinate_sizes(model)

    def by_coordinate(unit: Array) -> Array:
        return _slope(lambda t: forces(x + t * unit, v, caused), FIRST_STEP)

    def by_speed(unit: Array) -> Array:
        return (forces(x, v + unit, caused) - forces(x, v - unit, caused)) / 2

    demands = np.zeros((d, 2 * d + n))
    demands[:, :d] = -stiffness_matrix(model) - np.transpose([by_coordinate(unit) for unit in np.diag(size)]) / size
    demands[:, d : 2 * d] = -damping_matrix(model) - np.transpose([by_speed(unit) for unit in np.diag(size)]) / size
    motors, constants = model.motor_columns, model.constants
    steepness = constants.coulomb_friction / constants.coulomb_rate
    demands[motors, d + motors] -= steepness / np.cosh(v[motors] / constants.coulomb_rate) ** 2
    demands[model.motor_columns, 2 * d + np.arange(n)] = 1.0
    return demands


def coordinate_sizes(model: Model) -> Array:
    """Gives the size (d,) of each coordinate that turns a section by 1 rad or moves it by the length of its link."""
    sizes = np.ones(model.n_dof)
    for i, (link, basis) in enumerate(zip(model.arm.links, model.bases, strict=True)):
        moved = np.abs(basis).reshape(len(basis) // NODE_COORDINATES, 2, 3, basis.shape[1])
        largest = np.maximum(moved[:, 0] / link.length, moved[:, 1]).max(axis=(0, 1), initial=0.0)
        sizes[model.elastic_columns(i)] = 1.0 / largest
    return sizes


def _slope(function: Callable[[float], Array], h: float) -> Array:
    """Gives the first derivative at 0."""
    parts = [weight / (2 * k * h) * (function(k * h) - function(-k * h)) for k, weight in RICHARDSON]
    return np.sum(parts, axis=0)
