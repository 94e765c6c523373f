"""Static equilibrium under gravity with held motors, and the holding torques of the motors."""

from functools import lru_cache

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, Matrix, Vector
from flexman_gym.common.checks import value_error, vector
from flexman_gym.kernels import inverse, outputs
from flexman_gym.kernels.layout import OUTPUTS, TIP, Work, make_work
from flexman_gym.model.dynamics import elastic_forces, inertial_forces, stiffness_matrix
from flexman_gym.model.model import Model, check_model


def rest_state(model: Model, motor_angles: Vector | Matrix) -> Array:
    """Return the state of static equilibrium under gravity with the motors held at given angles.

    Without gravity the arm is undeformed. With gravity the equilibrium of weight, joint springs and links is found by a
    modified Newton iteration, with the stiffness matrix as constant Jacobian. A joint with backlash rests at the side
    of the gap to which its torque turns it, and in the middle without torque.

    Args:
        model: model of the arm.
        motor_angles: (n,) rad, or (r, n) for r postures; angles of passive joints follow from the equilibrium.

    Returns:
        State (2 d,) with zero speeds, or (r, 2 d) for r postures.

    Raises:
        ValueError: if the iteration does not converge, for a very compliant arm.

    Examples:
        An arm in a vertical plane sags: its joint springs twist under its weight.

        >>> model = fm.build_model(fm.catalog.vertical_2r())
        >>> state = fm.rest_state(model, [0.0, 0.5])
        >>> state[:2].round(3), state[model.motor_columns]  # joint and motor angles, rad
        (array([-0.035,  0.482]), array([0. , 0.5]))
    """
    if isinstance(motor_angles, np.ndarray) and motor_angles.ndim == 2:
        return _rest_states(model, motor_angles)
    angles = vector("motor_angles", motor_angles, check_model(model).n_joints, "rad")
    result: Array = _rest_states(model, np.array([angles]))[0]
    return result


def _rest_states(model: Model, postures: Array) -> Array:
    """Return the states (r, 2 d) of static equilibrium with the motors at angles (r, n), rad."""
    states, d = model.at_rest(postures * (model.constants.passive == 0)), model.n_dof
    if not model.constants.gravity.any():
        return states
    work, free, stiffness, compliance = _rest_system(model)
    zero, force = np.zeros(d), np.zeros(d)
    for posture, state in zip(postures, states, strict=True):
        change = inverse.solve_equilibrium(model.constants, work, stiffness, compliance, free, zero, state[:d], force)
        if not change <= inverse.EQUILIBRIUM_TOLERANCE:
            raise value_error("motor_angles", posture.tolist(), "an arm stiff enough to hold its own weight")
    return states


@lru_cache(maxsize=16)
def _rest_system(model: Model) -> tuple[Work, IntArray, Array, Array]:
    """Return scratch arrays, indices (d - n,) of free coordinates, stiffness (d, d), and its inverse over the indices.

    All calls can share the scratch arrays, because kernels overwrite them completely and hold the interpreter lock.
    """
    free = np.setdiff1d(np.arange(model.n_dof), model.driven_columns)
    stiffness = stiffness_matrix(model)
    return make_work(model.constants), free, stiffness, np.linalg.inv(stiffness[np.ix_(free, free)])


def holding_torques(model: Model, motor_angles: Vector) -> Array:
    """Return the motor torques (n,), N m, in static equilibrium with the motors held; zero without gravity.

    Args:
        model: model of the arm.
        motor_angles: (n,) rad.

    Raises:
        ValueError: if no equilibrium is found, see `rest_state`.

    Examples:
        >>> model = fm.build_model(fm.catalog.vertical_2r())
        >>> fm.holding_torques(model, [0.0, 0.0]).round(3)
        array([3.621, 1.147])
    """
    angles = vector("motor_angles", motor_angles, check_model(model).n_joints, "rad")
    x, zero = rest_state(model, angles)[: model.n_dof], np.zeros(model.n_dof)
    ripple = model.constants.ripple_torque * np.sin(
        model.constants.ripple_cycles * angles + model.constants.ripple_phase
    )
    return (inertial_forces(model)(x, zero, zero) + elastic_forces(model, x))[model.motor_columns] - ripple


def rigid_holding_torques(model: Model, motor_angles: Array) -> Array:
    """Return the joint torques (n,), N m, that hold the weight of the arm with rigid joints and links.

    Args:
        model: model of the arm.
        motor_angles: (n,) rad.
    """
    zero = np.zeros(model.n_dof)
    return inertial_forces(model)(model.at_rest(motor_angles[None])[0, : model.n_dof], zero, zero)[: model.n_joints]


def rest_tips(model: Model, postures: Array) -> Array:
    """Return the tip positions (r, 3), m, base frame, in static equilibrium with the motors at angles (r, n), rad."""
    work, row, tips = _rest_system(model)[0], np.zeros(OUTPUTS), np.zeros((len(postures), 3))
    for tip, state in zip(tips, _rest_states(model, postures), strict=True):
        outputs.compute_outputs(model.constants, work, state[: model.n_dof], state[model.n_dof :], row)
        tip[:] = row[TIP]
    return tips
