"""Stable static equilibrium of an arm with passive joints, such as a load that hangs on a boom."""

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.errors import value_error
from flexman_gym.kernels.inverse import EQUILIBRIUM_TOLERANCE
from flexman_gym.model.dynamics import elastic_forces, inertial_forces, inertial_jacobian, stiffness_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.state_space import natural_modes

MAX_TURN = 0.3  # rad; largest change of a joint angle in a step of Newton's method
NEUTRAL = 1e-4  # rad^2/s^2; squared frequency of a motion without restoring force
NEWTON_STEPS = 100


def tangent_matrices(model: Model, motion: Array, columns: IntArray) -> tuple[Array, Array]:
    """Return mass and stiffness (c, c) of some coordinates, with the stiffness of gravity and inertial forces.

    Args:
        model: model of the arm.
        motion: (3, d) coordinates, speeds and accelerations.
        columns: (c,) indices of the coordinates.
    """
    jacobian = inertial_jacobian(model, motion)[columns]
    springs = stiffness_matrix(model, motion[0])[np.ix_(columns, columns)]
    return jacobian[:, 2 * model.n_dof + columns], jacobian[:, columns] + springs


def hang(model: Model, posture: Array, coordinates: Array) -> Array:
    """Return the coordinates (d,) of the stable equilibrium of an arm with passive joints, by Newton's method.

    The stiffness includes that of gravity, m g l for a hanging load. In natural modes with negative stiffness the step
    is reversed, so that a load above its joint falls, and no joint turns by more than MAX_TURN in a step.

    Args:
        model: model of the arm.
        posture: (n,) motor angles, rad.
        coordinates: (d,) first guess.

    Raises:
        ValueError: if no equilibrium is found, or for a passive joint that neither spring nor gravity restores.
    """
    n, free, rest = model.n_joints, np.setdiff1d(np.arange(model.n_dof), model.driven_columns), np.zeros(model.n_dof)
    forces, x = inertial_forces(model), coordinates.copy()
    for _ in range(NEWTON_STEPS):
        residual = (forces(x, rest, rest) + elastic_forces(model, x))[free]
        mass, stiffness = tangent_matrices(model, np.array([x, rest, rest]), free)
        squares, shapes = natural_modes((mass + mass.T) / 2.0, (stiffness + stiffness.T) / 2.0)
        change = -shapes @ (shapes.T @ residual / np.maximum(np.abs(squares), NEUTRAL))
        if squares[0] < 0.0 and np.abs(change).max() < EQUILIBRIUM_TOLERANCE:
            change = change + shapes[:, 0] * MAX_TURN / np.abs(shapes[:, 0]).max()  # leaves an unstable equilibrium
        turn = np.abs(change[free < n]).max(initial=0.0)
        x[free] += change * min(1.0, MAX_TURN / turn if turn else 1.0)
        if np.abs(change).max() <= EQUILIBRIUM_TOLERANCE * max(1.0, np.abs(x).max()):
            break
    else:
        raise value_error("motor_angles", posture.tolist(), "an arm with a stable equilibrium in this posture")
    if squares[0] <= NEUTRAL:
        i = int(np.abs(shapes[:, 0] * (free < n)).argmax())
        allowed = f"a number > 0 (N m/rad): gravity does not restore this passive joint at {posture.tolist()} rad"
        raise value_error(f"arm.joints[{free[i]}].stiffness", model.arm.joints[free[i]].stiffness, allowed)
    return x
