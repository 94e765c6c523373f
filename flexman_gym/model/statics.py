"""Static equilibrium under gravity with held motors, and the holding torques of the motors."""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, Matrix, Vector
from flexman_gym.common.checks import vector
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import inverse, outputs
from flexman_gym.kernels.layout import OUTPUTS, TIP, Work, make_work
from flexman_gym.model.dynamics import elastic_forces, inertial_forces, stiffness_matrix
from flexman_gym.model.model import Model, check_model

TRIED_ANGLE = 0.3  # rad; motor angles at which the weight is compared
LARGEST_FACTOR, FACTOR_TOLERANCE = 1e6, 1e-3  # of the search for the stiffness of a joint that is too soft, 1


class _System(NamedTuple):
    """Scratch arrays and matrices of the static equilibrium of a model.

    All calls can share the scratch arrays, because kernels overwrite them completely and hold the interpreter lock.

    Attributes:
        work: scratch arrays.
        free: (f,) indices of the coordinates other than the motor angles.
        stiffness: (d, d) stiffness matrix without gravity.
        compliance: (f, f) inverse of the stiffness of the free coordinates.
    """

    work: Work
    free: IntArray
    stiffness: Array
    compliance: Array


def rest_state(model: Model, motor_angles: Vector | Matrix) -> Array:
    """Return the state of static equilibrium under gravity with the motors held at given angles.

    Without gravity the arm is undeformed. With gravity the equilibrium of weight, joint springs and links is found by a
    modified Newton iteration, with the stiffness matrix as constant Jacobian; loads on passive joints without spring
    hang at the stable equilibrium, found by Newton's method. A joint with backlash rests at the side of the gap to
    which its torque turns it, and in the middle without torque.

    Args:
        model: model of the arm.
        motor_angles: (n,) rad, or (r, n) for r postures; angles of passive joints follow from the equilibrium.

    Returns:
        State (2 d,) with zero speeds, or (r, 2 d) for r postures.

    Raises:
        ValueError: if the iteration does not converge, for an arm that is too compliant for its weight; the message has
            the stiffness that a joint needs. Also for a passive joint that neither spring nor gravity restores.

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


def free_joints(model: Model) -> list[int]:
    """Return the indices of the passive joints without spring, with which the stiffness matrix is singular."""
    constants = model.constants
    return list(np.flatnonzero((constants.passive > 0) & (constants.passive_stiffness == 0.0)))


def _rest_states(model: Model, postures: Array) -> Array:
    """Return the states (r, 2 d) of static equilibrium with the motors at angles (r, n), rad."""
    states, d = model.at_rest(postures * (model.constants.passive == 0)), model.n_dof
    if not model.constants.gravity.any():
        return states
    system = None if free_joints(model) else _rest_system(model)
    for posture, state in zip(postures, states, strict=True):
        start = state[:d].copy()
        if system and _relax(model, system, state[:d]):
            continue
        if not model.constants.passive.any():
            raise value_error("motor_angles", posture.tolist(), _missing_stiffness(model, posture))
        from flexman_gym.model.hanging import hang

        state[:d] = hang(model, posture, start)
    return states


def _relax(model: Model, system: _System, coordinates: Array) -> bool:
    """Move coordinates (d,) to the static equilibrium; return False if the iteration does not converge."""
    zero, force = np.zeros(model.n_dof), np.zeros(model.n_dof)
    change = inverse.solve_equilibrium(
        model.constants, system.work, system.stiffness, system.compliance, system.free, zero, coordinates, force
    )
    return bool(change <= inverse.EQUILIBRIUM_TOLERANCE)


@lru_cache(maxsize=16)
def _rest_system(model: Model) -> _System:
    """Return the system of a model; see `_System`."""
    free = np.setdiff1d(np.arange(model.n_dof), model.driven_columns)
    stiffness = stiffness_matrix(model)
    return _System(make_work(model.constants), free, stiffness, np.linalg.inv(stiffness[np.ix_(free, free)]))


def _missing_stiffness(model: Model, posture: Array) -> str:
    """Return the end of an error: the stiffness of a joint that holds the weight at motor angles (n,), rad."""
    n, constants = model.n_joints, model.constants
    springs = np.where(constants.passive, constants.passive_stiffness, constants.joint_stiffness)

    def holds(factors: Array) -> bool:
        stiffer = {name: getattr(constants, name) * factors for name in ("joint_stiffness", "passive_stiffness")}
        changed = replace(model, constants=constants._replace(**stiffer))
        start = changed.at_rest(posture[None] * (constants.passive == 0))[0, : model.n_dof]
        return _relax(changed, _rest_system.__wrapped__(changed), start)

    for chosen in [*np.eye(n, dtype=bool)[springs > 0.0], springs > 0.0]:
        if holds(np.where(chosen, LARGEST_FACTOR, 1.0)):
            low, high = 0.0, np.log(LARGEST_FACTOR)
            while high - low > FACTOR_TOLERANCE:
                middle = (low + high) / 2.0
                low, high = (low, middle) if holds(np.where(chosen, np.exp(middle), 1.0)) else (middle, high)
            stiffer = np.exp(high) * springs
            needed = (
                f"joint {i + 1} needs a stiffness of about {stiffer[i]:.3g} N m/rad, not {springs[i]:.3g}"
                for i in np.flatnonzero(chosen)
            )
            return f"an arm stiff enough to hold its own weight in this posture: {'; '.join(needed)}"
    return "an arm stiff enough to hold its own weight in this posture: stiffer joints do not suffice, its links bend"


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
    return static_torques(model, rest_state(model, angles)[: model.n_dof])


def static_torques(model: Model, coordinates: Array) -> Array:
    """Return the motor torques (n,), N m, that hold an arm at its equilibrium coordinates (d,), see `rest_state`.

    The torque of a passive joint is 0.
    """
    angles, zero = coordinates[model.motor_columns], np.zeros(model.n_dof)
    ripple = model.constants.ripple_torque * np.sin(
        model.constants.ripple_cycles * angles + model.constants.ripple_phase
    )
    forces = inertial_forces(model)(coordinates, zero, zero) + elastic_forces(model, coordinates)
    result: Array = (forces[model.motor_columns] - ripple) * (1 - model.constants.passive)
    return result


def rigid_holding_torques(model: Model, motor_angles: Array) -> Array:
    """Return the joint torques (n,), N m, that hold the weight of the arm with rigid joints and links.

    Args:
        model: model of the arm.
        motor_angles: (n,) rad.
    """
    zero = np.zeros(model.n_dof)
    return inertial_forces(model)(model.at_rest(motor_angles[None])[0, : model.n_dof], zero, zero)[: model.n_joints]


def first_angle_is_free(model: Model) -> bool:
    """Return True for an arm whose motion does not depend on its first angle: without gravity or about its axis."""
    posture, rotation = np.full(model.n_joints, TRIED_ANGLE), np.eye(model.n_joints)[0]
    return np.allclose(holding_torques(model, posture), holding_torques(model, posture + rotation))


def rest_tips(model: Model, postures: Array) -> Array:
    """Return the tip positions (r, 3), m, base frame, in static equilibrium with the motors at angles (r, n), rad."""
    work, row, tips = make_work(model.constants), np.zeros(OUTPUTS), np.zeros((len(postures), 3))
    for tip, state in zip(tips, _rest_states(model, postures), strict=True):
        outputs.compute_outputs(model.constants, work, state[: model.n_dof], state[model.n_dof :], row)
        tip[:] = row[TIP]
    return tips
