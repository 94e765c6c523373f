"""Equations of motion at one state: accelerations, matrices, frequencies, inverse dynamics; see `docs/theory.md`.

The paper is "Dynamic modeling and simulation of spatial manipulator with flexible links and joints".
"""

from collections.abc import Callable
from functools import lru_cache
from typing import TypeGuard

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, Matrix, Vector
from flexman_gym.common.checks import check_magnitudes, flag, number_array, vector
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import dynamics, inverse, outputs
from flexman_gym.kernels.arguments import TangentTables, address_tables, aligned_zeros, tangent_constants
from flexman_gym.kernels.layout import (
    LARGEST_STATE,
    OUTPUTS,
    TIP_ACCELERATION,
    TIP_ACCELERATIONS,
    TIP_VELOCITY,
    Constants,
    Work,
    make_work,
)
from flexman_gym.model.friction import coulomb_torques
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.state_space import natural_modes

Forces = Callable[[Array, Array, Array], Array]  # generalised forces of coordinates, speeds and accelerations

# Richardson extrapolation to h = 0 of central differences: step / h and weight of each. The error is h^6 / 140 times
# the seventh derivative for a first derivative, and h^6 / 560 times the eighth for a second derivative.
RICHARDSON = ((1, 1.5), (2, -0.6), (3, 0.1))
SECOND_STEP = 0.02  # rad; step for second derivatives, at which the truncation error is just below rounding


def acceleration(model: Model, state: Vector, torque: Vector) -> Array:
    """Return the generalised accelerations (d,) at a state under motor torques, Eqs. (45) and (23), see `model.beam`.

    Units are rad/s^2 for angles, m/s^2 and rad/s^2 for node coordinates, kg^(1/2) m/s^2 for modal coordinates.

    Args:
        model: model of the arm.
        state: (2 d,) coordinates and speeds in the order of `kernels.layout`.
        torque: (n,) motor torques, N m.

    Examples:
        A torque of 1 N m on a rotor of 0.01 kg m^2 behind a joint spring:

        >>> model = fm.build_model(fm.catalog.one_joint())
        >>> fm.acceleration(model, fm.rest_state(model, [0.0]), [1.0])[model.motor_columns]
        array([100.])
    """
    x, v = split_state(model, state)
    out = np.zeros(model.n_dof)
    dynamics.accelerations(model.constants, make_work(model.constants), x, v, _drive(model, torque), out)
    if not np.isfinite(out).all():
        raise value_error("torque", torque, "torques (N m) with finite accelerations")
    return out


def mass_matrix(model: Model, state: Vector) -> Array:
    """Return the generalised mass matrix (d, d) at a state, including the rotors (Eqs. (46) and (23) of the paper).

    Args:
        model: model of the arm.
        state: (2 d,) coordinates and speeds; the matrix does not depend on the speeds.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint(), elements=1)
        >>> mass = fm.mass_matrix(model, fm.rest_state(model, [0.5]))
        >>> mass.shape, bool((mass == mass.T).all())
        ((8, 8), True)
    """
    x, _ = split_state(model, state)
    return _mass_matrix(model, inertial_forces(model, np.zeros(3)), x)


def _mass_matrix(model: Model, forces: Forces, x: Array) -> Array:
    """Return the mass matrix (d, d) at coordinates (d,): its columns are the forces of unit accelerations at rest."""
    rest = np.zeros(model.n_dof)
    matrix = np.array([forces(x, rest, unit) for unit in np.eye(model.n_dof)])
    return (matrix + matrix.T) / 2


def stiffness_matrix(model: Model, coordinates: Array | None = None) -> Array:
    """Return the stiffness matrix (d, d) of links and joint springs, in N/m, N m/rad or the units of modal coordinates.

    Args:
        model: model of the arm.
        coordinates: (d,) coordinates at which joint springs with backlash or stiffness pieces have their tangent
            stiffness, 0 within a gap; None for their full stiffness, beyond the gap and all pieces.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint(), elements=1)
        >>> stiffness = fm.stiffness_matrix(model)
        >>> stiffness.shape, stiffness[:2, :2]  # joint spring between joint and motor angle, N m/rad
        ((8, 8), array([[ 20., -20.],
               [-20.,  20.]]))
    """
    values = check_model(model).constants.joint_stiffness
    if coordinates is not None:
        values = np.zeros(model.n_joints)
        inverse.spring_slopes(model.constants, coordinates, values)
    matrix = _assemble(model, values, model.constants.stiffness)
    passive = np.flatnonzero(model.constants.passive)
    matrix[passive, passive] = model.constants.passive_stiffness[passive]
    return matrix


def elastic_forces(model: Model, coordinates: Array) -> Array:
    """Return the generalised forces (d,) that hold links and joint springs at coordinates (d,)."""
    linear = np.array(coordinates)
    inverse.linear_twists(model.constants, linear)
    return stiffness_matrix(model) @ linear


def damping_matrix(model: Model) -> Array:
    """Return the damping matrix (d, d) of links, joint dampers and viscous friction, in the units of stiffness times s.

    Args:
        model: model of the arm.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint(), elements=1)
        >>> fm.damping_matrix(model)[:2, :2]  # joint damper between joint and motor angle, N m s/rad
        array([[ 0.005, -0.005],
               [-0.005,  0.005]])
    """
    matrix = _assemble(check_model(model), model.constants.joint_damping, model.constants.damping)
    matrix[model.motor_columns, model.motor_columns] += model.constants.rotor_damping
    return matrix


def frequencies(model: Model, joint_angles: Vector | Matrix | None = None, lock_joints: bool = False) -> Array:
    """Return the undamped natural frequencies of the undeformed arm, Hz, ascending, without gravity.

    Low frequencies are accurate to rounding even if the model also has very high ones, so that their derivatives can be
    computed by finite differences.

    Args:
        model: model of the arm.
        joint_angles: (n,) rad, zero by default, or (k, n) for k postures.
        lock_joints: False leaves the motors free and returns d frequencies; the first n, of the rigid rotations about
            the joints, are zero. True locks the motors, and rigid joints, and returns the d - n frequencies of the
            remaining coordinates. Passive joints are never locked, and do not count in n.

    Returns:
        Frequencies (d,) or (d - n,), with a leading axis of length k for k postures.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint())
        >>> fm.frequencies(model, lock_joints=True)[:2].round(2)
        array([ 1.41, 11.26])
    """
    n = check_model(model).n_joints
    angles = np.zeros(n) if joint_angles is None else joint_angles
    if _has_rows(angles):
        angles = number_array("joint_angles", angles, (len(angles), n), f"numbers ({n},) or (k, {n}), rad")
    rows = angles if _has_rows(angles) else [angles]
    free = np.arange(model.n_dof)
    if flag("lock_joints", lock_joints):
        free = np.setdiff1d(free, model.driven_columns)
    stiffness, result = stiffness_matrix(model)[np.ix_(free, free)], np.zeros((len(rows), len(free)))
    forces = inertial_forces(model, np.zeros(3))
    for row, posture in zip(result, rows, strict=True):
        mass = _mass_matrix(model, forces, split_state(model, model.initial_state(posture))[0])[np.ix_(free, free)]
        row[:] = natural_modes(mass, stiffness)[0] if len(free) else 0.0
    if not lock_joints:
        result[:, : len(model.driven_columns)] = 0.0
    result = np.sqrt(np.maximum(result, 0.0)) / (2 * np.pi)
    return result if rows is angles else result[0]


def _has_rows(angles: object) -> TypeGuard[Array]:
    """Return True if joint angles are given for several postures, one per row."""
    if isinstance(angles, np.ndarray):
        return angles.ndim > 1
    return isinstance(angles, list | tuple) and bool(angles) and isinstance(angles[0], list | tuple | np.ndarray)


def tip_acceleration(model: Model, state: Vector, torque: Vector) -> Array:
    """Return the acceleration (3,) of the tip in the base frame, m/s^2.

    It is the second time derivative of the tip position, Eq. (30) with the terms of Eq. (32) of the paper, exact to
    rounding. An ideal accelerometer at the tip measures this value minus the acceleration of gravity.

    Args:
        model: model of the arm.
        state: (2 d,) coordinates and speeds.
        torque: (n,) motor torques, N m.

    Examples:
        >>> arm = fm.catalog.one_joint()
        >>> model = fm.build_model(arm, flexible_links=False, flexible_joints=False)
        >>> fm.tip_acceleration(model, fm.rest_state(model, [0.0]), [0.0])
        array([0., 0., 0.])
    """
    x, v = split_state(model, state)
    out = np.zeros(TIP_ACCELERATIONS)
    outputs.tip_accelerations(model.constants, make_work(model.constants), x, v, _drive(model, torque), out)
    return out[TIP_ACCELERATION]


def inverse_dynamics(
    model: Model,
    joint_angles: Vector,
    joint_rates: Vector,
    joint_accelerations: Vector,
    joint_jerks: Vector | None = None,
    joint_snaps: Vector | None = None,
) -> Array:
    """Return the motor torques (n,), N m, for a motion of the joint angles (link side) of an arm with rigid links.

    For rigid joints the torques are exact to rounding. The motor angle of a flexible joint exceeds the joint angle by
    the joint torque divided by the joint stiffness (Spong 1987, J. Dyn. Syst. 109, 310); the second time derivative of
    this difference is computed by finite differences of order six along the motion.

    Args:
        model: model with rigid links. Flexible joints must have neither damping nor friction, no motor
            torque ripple, no spring backlash or stiffness pieces, and `spinning_rotors` must be False.
        joint_angles: (n,) rad.
        joint_rates: (n,) rad/s.
        joint_accelerations: (n,) rad/s^2.
        joint_jerks: (n,) rad/s^3; required for flexible joints.
        joint_snaps: (n,) rad/s^4; required for flexible joints.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint(), flexible_links=False, flexible_joints=False)
        >>> torque = fm.inverse_dynamics(model, [0.0], [0.0], [2.0])
        >>> torque.round(6), fm.acceleration(model, fm.rest_state(model, [0.0]), torque).round(6)
        (array([0.139296]), array([2.]))
    """
    n, constants = check_model(model).n_joints, model.constants
    motion = np.zeros((5, n))
    given = (joint_angles, joint_rates, joint_accelerations, joint_jerks, joint_snaps)
    names = ("joint_angles", "joint_rates", "joint_accelerations", "joint_jerks", "joint_snaps")
    for order, (name, values) in enumerate(zip(names, given, strict=True)):
        if order < 3 or model.n_motors > 0 or values is not None:
            motion[order] = vector(name, values, n, "rad" if order == 0 else f"rad/s^{order}".removesuffix("^1"))
            check_magnitudes(name, motion[order].tolist(), LARGEST_STATE if order < 2 else np.inf)
    flexible = constants.motor >= 0
    _check_invertible(model, flexible)
    forces, spread = inertial_forces(model), np.zeros((model.n_dof, n))
    spread[np.arange(n), np.arange(n)] = 1.0  # rotors of flexible joints at rest; their torques are added below

    def link_torques(t: float) -> Array:
        taylor = t ** np.arange(5) / np.array([1.0, 1.0, 2.0, 6.0, 24.0])
        return forces(*(spread @ (taylor[: 5 - order] @ motion[order:]) for order in range(3)))[:n]

    torques = link_torques(0.0) + constants.rotor_damping * motion[1]
    torques += coulomb_torques(model, motion[1])
    if model.n_motors == 0:
        return _finite_torques(torques, joint_accelerations)
    rate_scale = max(np.abs(row).sum() ** (1 / order) for order, row in enumerate(motion[1:], start=1))  # rad/s
    curvature = _second_derivative(link_torques, SECOND_STEP / max(rate_scale, 1e-3))[flexible]  # N m/s^2
    twist_acceleration = curvature / constants.joint_stiffness[flexible]
    torques[flexible] += constants.rotor_inertia[flexible] * (motion[2, flexible] + twist_acceleration)
    return _finite_torques(torques, joint_accelerations)


def _finite_torques(torques: Array, joint_accelerations: object) -> Array:
    """Return the torques (n,) after checking that they are finite."""
    if not np.isfinite(torques).all():
        raise value_error("joint_accelerations", joint_accelerations, "a motion with finite torques")
    return torques


def _check_invertible(model: Model, flexible: BoolArray) -> None:
    """Check that the motion of the joints alone determines the motor torques.

    Args:
        model: model of the arm.
        flexible: (n,) True for flexible joints.
    """
    constants = model.constants
    if model.n_elastic > 0:
        allowed = "False: with flexible links the joint motion does not determine the torques"
        raise value_error("model.choice.flexible_links", model.choice.flexible_links, allowed)
    for field in ("joint_damping", "rotor_damping", "coulomb_friction"):
        values = getattr(constants, field)
        for i in np.flatnonzero(flexible & (values > 0.0)):
            name = field.removeprefix("joint_")
            raise value_error(f"model.arm.joints[{i}].{name}", float(values[i]), "0 for flexible joints")
    if model.constants.knee_start[-1] > 0:
        raise value_error("model.arm.joints", "with backlash or stiffness pieces", "linear joint springs")
    if constants.has_ripple.any():
        raise value_error("model.arm.joints", "with torque ripple", "motors without torque ripple")
    if (flexible & (constants.carried_inertia > 0.0)).any():
        raise value_error("model.choice.spinning_rotors", True, "False for flexible joints")


def _drive(model: Model, torque: Vector) -> Array:
    """Return inputs (n + 6,): n motor torques, N m, zero tip force (3, N) and zero base acceleration (3, m/s^2)."""
    return np.r_[vector("torque", torque, model.n_joints, "N m"), np.zeros(6)]


def split_state(model: Model, state: Vector) -> tuple[Array, Array]:
    """Return coordinates (d,) and speeds (d,) of a state (2 d,) after checking that no magnitude exceeds 1e6."""
    values = np.array(vector("state", state, 2 * check_model(model).n_dof))
    check_magnitudes("state", values.tolist(), LARGEST_STATE)
    return values[: model.n_dof], values[model.n_dof :]


def _assemble(model: Model, joint_values: Array, link_blocks: Array) -> Array:
    """Assemble the stiffness or damping matrix (d, d) from joint values (n,) and packed matrices of the links."""
    starts = model.constants.square_start
    matrix = np.zeros((model.n_dof, model.n_dof))
    for i, motor in enumerate(model.constants.motor):
        if motor >= 0:
            matrix[np.ix_([i, motor], [i, motor])] = joint_values[i] * np.array([[1, -1], [-1, 1]])
        columns = model.elastic_columns(i)
        size = columns.stop - columns.start
        matrix[columns, columns] = link_blocks[starts[i] : starts[i + 1]].reshape(size, size)
    return matrix


def inertial_forces(model: Model, gravity: Array | None = None) -> Forces:
    """Return a function that computes the generalised inertial and gravity forces (d,) of a motion.

    They are M(x) a + h(x, v), for coordinates x, speeds v and accelerations a, (d,) each, with the weight in h.

    Args:
        model: model of the arm.
        gravity: acceleration of gravity (3,), m/s^2; None for the gravity of the model.
    """
    constants = model.constants if gravity is None else model.constants._replace(gravity=gravity)
    work = make_work(constants)

    def forces(x: Array, v: Array, accelerations: Array) -> Array:
        out = np.zeros(model.n_dof)
        inverse.inertial_forces(constants, work, x, v, accelerations, out)
        return out

    return forces


def inertial_jacobian(model: Model, motion: Array) -> Array:
    """Return the Jacobian (d + 3, 3 d) of inertial and gravity forces (d,) and tip velocity (3,), exact to rounding.

    Args:
        model: model of the arm.
        motion: (3, d) coordinates, speeds and accelerations; the columns are their entries in this order.
    """
    out = np.zeros((model.n_dof + 3, motion.size))
    inverse.inertial_jacobian(_tangent_tables(model)[0], motion, out)
    return out


@lru_cache(maxsize=16)
def _tangent_tables(model: Model) -> tuple[tuple[IntArray, IntArray], Constants, Work]:
    """Return addresses of the arrays of a model with derivatives, and the arrays, which must live as long.

    All calls can share the scratch arrays, see `statics._System`.
    """
    constants, work = tangent_constants(model.constants), make_work(model.constants, aligned_zeros)
    return address_tables(TangentTables, constants, work), constants, work


def tip_jacobian(model: Model, x: Array) -> Array:
    """Return the Jacobian (3, d) of the tip velocity (m/s, base frame) with respect to the speeds, at coordinates x."""
    rows = np.zeros((model.n_dof, OUTPUTS))
    work = make_work(model.constants)
    for row, unit in zip(rows, np.eye(model.n_dof), strict=True):
        outputs.compute_outputs(model.constants, work, x, unit, row)
    return rows[:, TIP_VELOCITY].T


def _second_derivative(function: Callable[[float], Array], h: float) -> Array:
    """Return the second derivative of a function at 0 by central differences with step h, extrapolated to order six."""
    middle = 2.0 * function(0.0)
    parts = [weight / (k * h) ** 2 * (function(k * h) - middle + function(-k * h)) for k, weight in RICHARDSON]
    return np.sum(parts, axis=0)
