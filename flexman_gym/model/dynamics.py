"""Equations of motion at a state: accelerations, matrices, frequencies, inverse dynamics, tip Jacobian."""

from collections.abc import Callable
from typing import TypeGuard

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, Matrix, Vector
from flexman_gym.common.checks import check_magnitudes, flag, number_array, value_error, vector
from flexman_gym.kernels import dynamics, inverse, outputs
from flexman_gym.kernels.layout import (
    LARGEST_STATE,
    OUTPUTS,
    TIP_ACCELERATION,
    TIP_ACCELERATIONS,
    TIP_VELOCITY,
    make_work,
)
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.natural_modes import natural_modes

Forces = Callable[[Array, Array, Array], Array]

# Central differences over one, two and three steps h, each with its weight in Richardson's extrapolation to h = 0. The
# error of a first derivative is h^6 / 140 times the seventh derivative, of a second one h^6 / 560 times the eighth.
RICHARDSON = ((1, 1.5), (2, -0.6), (3, 0.1))
SECOND_STEP = 0.02  # rad, for a second derivative: its truncation is just below rounding


def acceleration(model: Model, state: Vector, torque: Vector) -> Array:
    """Gives the generalised accelerations (d,) (Eq. 45 with Eq. 23).

    Args:
        model: the model.
        state: (2 d,).
        torque: (n,) of the motors, N m.

    Raises:
        ValueError: for wrong shapes or values that are not finite.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint())
        >>> fm.acceleration(model, fm.rest_state(model, [0.0]), [1.0])[model.motor_columns]
        array([100.])
    """
    x, v = split_state(model, state)
    out = np.zeros(model.n_dof)
    dynamics.accelerations(model.constants, make_work(model.constants), x, v, _drive(model, torque), out)
    if not np.isfinite(out).all():
        raise value_error("torque", torque, "torques (N m) whose accelerations are finite numbers")
    return out


def mass_matrix(model: Model, state: Vector) -> Array:
    """Gives the generalised mass matrix (d, d) at a state (2 d,), rotors included (Eq. 46 with Eq. 23).

    Raises:
        ValueError: for a wrong shape or values that are not finite.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint(), elements=1)
        >>> fm.mass_matrix(model, fm.rest_state(model, [0.5])).shape
        (8, 8)
    """
    x, _ = split_state(model, state)
    return _mass_matrix(model, inertial_forces(model, np.zeros(3)), x)


def _mass_matrix(model: Model, forces: Forces, x: Array) -> Array:
    """Gives the mass matrix (d, d) at coordinates (d,), a column for each unit of acceleration."""
    rest = np.zeros(model.n_dof)
    matrix = np.array([forces(x, rest, unit) for unit in np.eye(model.n_dof)])
    return (matrix + matrix.T) / 2


def stiffness_matrix(model: Model) -> Array:
    """Gives the stiffness matrix (d, d) of links and joint springs: N m/rad, N/m and so on, by the coordinates.

    Raises:
        ValueError: for anything but a Model.
    """
    return _structure(check_model(model), model.constants.joint_stiffness, model.constants.stiffness)


def damping_matrix(model: Model) -> Array:
    """Gives the damping matrix (d, d) of links, joint dampers and viscous friction, times s of the stiffness.

    Raises:
        ValueError: for anything but a Model.
    """
    matrix = _structure(check_model(model), model.constants.joint_damping, model.constants.damping)
    matrix[model.motor_columns, model.motor_columns] += model.constants.viscous_friction
    return matrix


def frequencies(model: Model, joint_angles: Vector | Matrix | None = None, lock_joints: bool = False) -> Array:
    """Gives the undamped natural frequencies of the unloaded arm at rest, ascending, Hz; gravity is left out.

    The slow ones are exact up to rounding, beside fast ones too, so that they can be differentiated by differences.

    Args:
        model: the model.
        joint_angles: (n,) rad, zero by default; or (k, n), for as many rows of frequencies.
        lock_joints: False leaves the motors free. There are then d frequencies; the first n are zero, as the arm can
            turn about its joints. True clamps the motors (the joints where they are rigid); the other d - n frequencies
            remain.

    Raises:
        ValueError: for anything but a Model, for wrong joint angles and a wrong flag.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint())
        >>> fm.frequencies(model, lock_joints=True)[:2].round(2)
        array([ 1.41, 11.26])
    """
    n = check_model(model).n_joints
    angles = np.zeros(n) if joint_angles is None else joint_angles
    if _several(angles):
        angles = number_array("joint_angles", angles, (len(angles), n), f"numbers ({n},) or (k, {n}), rad")
    rows = angles if _several(angles) else [angles]
    free = np.arange(model.n_dof)
    if flag("lock_joints", lock_joints):
        free = np.setdiff1d(free, model.motor_columns)
    stiffness, result = stiffness_matrix(model)[np.ix_(free, free)], np.zeros((len(rows), len(free)))
    forces = inertial_forces(model, np.zeros(3))
    for row, posture in zip(result, rows, strict=True):
        mass = _mass_matrix(model, forces, split_state(model, model.initial_state(posture))[0])[np.ix_(free, free)]
        row[:] = natural_modes(mass, stiffness)[0] if len(free) else 0.0
    if not lock_joints:
        result[:, :n] = 0.0
    result = np.sqrt(np.maximum(result, 0.0)) / (2 * np.pi)
    return result if rows is angles else result[0]


def _several(angles: object) -> TypeGuard[Array]:
    """Whether joint angles are those of several postures."""
    if isinstance(angles, np.ndarray):
        return angles.ndim > 1
    return isinstance(angles, list | tuple) and bool(angles) and isinstance(angles[0], list | tuple | np.ndarray)


def tip_acceleration(model: Model, state: Vector, torque: Vector) -> Array:
    """Gives the acceleration (3,) of the tip in the base frame, m/s^2.

    It is the second derivative of the tip's position (Eq. 32, 33), exact up to rounding. An accelerometer on the tip
    would show it less gravity.

    Args:
        model: the model.
        state: (2 d,).
        torque: (n,) of the motors, N m.

    Raises:
        ValueError: for wrong shapes or values that are not finite.
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
    """Gives the motor torques (n,) in N m for a motion of the joints (link side) of an arm of rigid links.

    Those of rigid joints are exact up to rounding. A motor on a spring runs ahead by the torque on the links over the
    stiffness (Spong 1987, J. Dyn. Syst. 109, 310). Its acceleration is a difference along the motion, of order six.

    Args:
        model: the model.
        joint_angles: (n,) rad.
        joint_rates: (n,) rad/s.
        joint_accelerations: (n,) rad/s^2.
        joint_jerks: (n,) rad/s^3; flexible joints need them.
        joint_snaps: (n,) rad/s^4; flexible joints need them.

    Raises:
        ValueError: for wrong shapes, values that are not finite, missing jerks or snaps, a flexible link, and for a
            flexible joint with a damper, with friction of its motor or with a spinning rotor.
    """
    n, constants = check_model(model).n_joints, model.constants
    motion = np.zeros((5, n))
    given = (joint_angles, joint_rates, joint_accelerations, joint_jerks, joint_snaps)
    names = ("joint_angles", "joint_rates", "joint_accelerations", "joint_jerks", "joint_snaps")
    for order, (name, values) in enumerate(zip(names, given, strict=True)):
        if order < 3 or model.n_motors > 0 or values is not None:
            motion[order] = vector(name, values, n, "rad" if order == 0 else f"rad/s^{order}".removesuffix("^1"))
            check_magnitudes(name, motion[order].tolist(), LARGEST_STATE if order < 2 else np.inf)
    sprung = constants.motor >= 0
    _check_invertible(model, sprung)
    forces, spread = inertial_forces(model), np.zeros((model.n_dof, n))
    spread[np.arange(n), np.arange(n)] = 1.0  # rotors on springs stand still: their torques are added below

    def link_torques(t: float) -> Array:
        powers = t ** np.arange(5) / np.array([1.0, 1.0, 2.0, 6.0, 24.0])
        return forces(*(spread @ (powers[: 5 - order] @ motion[order:]) for order in range(3)))[:n]

    torques = link_torques(0.0) + constants.viscous_friction * motion[1]
    torques += constants.coulomb_friction * np.tanh(motion[1] / constants.coulomb_rate)
    if model.n_motors == 0:
        return _finite_torques(torques, joint_accelerations)
    quickest = max(np.abs(row).sum() ** (1 / order) for order, row in enumerate(motion[1:], start=1))
    runs_ahead = _bend(link_torques, SECOND_STEP / max(quickest, 1e-3))[sprung] / constants.joint_stiffness[sprung]
    torques[sprung] += constants.rotor_inertia[sprung] * (motion[2, sprung] + runs_ahead)
    return _finite_torques(torques, joint_accelerations)


def _finite_torques(torques: Array, joint_accelerations: object) -> Array:
    if not np.isfinite(torques).all():
        raise value_error("joint_accelerations", joint_accelerations, "a motion whose torques are finite numbers")
    return torques


def _check_invertible(model: Model, sprung: BoolArray) -> None:
    """Refuses a model whose joint motion alone does not decide the torques; `sprung` (n,) joints are flexible."""
    constants = model.constants
    if model.n_elastic > 0:
        allowed = "False: bending links have no motion of joints that decides the torques"
        raise value_error("model.choice.flexible_links", model.choice.flexible_links, allowed)
    for field in ("joint_damping", "viscous_friction", "coulomb_friction"):
        values = getattr(constants, field)
        for i in np.flatnonzero(sprung & (values > 0.0)):
            name = field.removeprefix("joint_")
            raise value_error(f"model.arm.joints[{i}].{name}", float(values[i]), "0 where joints are flexible")
    if (sprung & (constants.carried_inertia > 0.0)).any():
        raise value_error("model.choice.spinning_rotors", True, "False where joints are flexible")


def _drive(model: Model, torque: Vector) -> Array:
    """Gives the drive (n + 6,) of motor torques (n,) without disturbances."""
    return np.r_[vector("torque", torque, model.n_joints, "N m"), np.zeros(6)]


def split_state(model: Model, state: Vector) -> tuple[Array, Array]:
    """Gives coordinates (d,) and speeds (d,) of a state (2 d,).

    Raises:
        ValueError: for a wrong shape, and values that are not finite or beyond 1e6.
    """
    values = np.array(vector("state", state, 2 * check_model(model).n_dof))
    check_magnitudes("state", values.tolist(), LARGEST_STATE)
    return values[: model.n_dof], values[model.n_dof :]


def _structure(model: Model, joints: Array, links: Array) -> Array:
    """Gives the matrix (d, d) of terms between motors and joints, (n,), and of terms in the links, packed blocks."""
    starts = model.constants.square_start
    matrix = np.zeros((model.n_dof, model.n_dof))
    for i, motor in enumerate(model.constants.motor):
        if motor >= 0:
            matrix[np.ix_([i, motor], [i, motor])] = joints[i] * np.array([[1, -1], [-1, 1]])
        columns = model.elastic_columns(i)
        size = columns.stop - columns.start
        matrix[columns, columns] = links[starts[i] : starts[i + 1]].reshape(size, size)
    return matrix


def inertial_forces(model: Model, gravity: Array | None = None) -> Forces:
    """Gives a function of coordinates, speeds and accelerations (d,) whose value is the forces (d,) that they demand.

    Args:
        model: the model.
        gravity: (3,) m/s^2, in place of that of the model.
    """
    constants = model.constants if gravity is None else model.constants._replace(gravity=gravity)
    work = make_work(constants)

    def forces(x: Array, v: Array, rates: Array) -> Array:
        out = np.zeros(model.n_dof)
        inverse.inertial_forces(constants, work, x, v, rates, out)
        return out

    return forces


def tip_jacobian(model: Model, x: Array) -> Array:
    """Gives the tip velocity per unit speed, (3, d), at coordinates (d,)."""
    rows = np.zeros((model.n_dof, OUTPUTS))
    work = make_work(model.constants)
    for row, unit in zip(rows, np.eye(model.n_dof), strict=True):
        outputs.compute_outputs(model.constants, work, x, unit, row)
    return rows[:, TIP_VELOCITY].T


def _bend(function: Callable[[float], Array], h: float) -> Array:
    """Gives the second derivative at 0."""
    middle = 2.0 * function(0.0)
    parts = [weight / (k * h) ** 2 * (function(k * h) - middle + function(-k * h)) for k, weight in RICHARDSON]
    return np.sum(parts, axis=0)
