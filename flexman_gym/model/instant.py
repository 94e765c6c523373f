"""Dynamics at an instant: accelerations, forces, natural frequencies and the linear model of a model at a state."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal, vector
from flexman_gym.kernels import dynamics, inverse, outputs
from flexman_gym.kernels.layout import OUTPUTS, TIP_VELOCITY, make_work
from flexman_gym.model.beam import NODE_COORDINATES
from flexman_gym.model.model import Model

# Central differences over one, two and three steps h, each with its weight in Richardson's extrapolation to h = 0: what
# is left of a first derivative is h^6 / 140 times the seventh, of a second one h^6 / 560 times the eighth.
RICHARDSON = ((1, 1.5), (2, -0.6), (3, 0.1))
FIRST_STEP, SECOND_STEP = 0.005, 0.02  # rad, of first and second derivatives: truncation just below rounding


class LinearModel(NamedTuple):
    """x' = A x + B u, y = C x + D u for small departures from a state and its torques.

    x (2 d,) = [coordinates, speeds] in the order of `kernels.layout`, u (n,) motor torques in N m, y (3,) the tip in
    the base frame in m.
    """

    A: Array  # (2 d, 2 d)
    B: Array  # (2 d, n)
    C: Array  # (3, 2 d)
    D: Array  # (3, n), zero


def acceleration(model: Model, state: Sequence[float] | Array, torque: Sequence[float] | Array) -> Array:
    """Generalised accelerations (d,) at a state (2 d,) under motor torques (n,) in N m (Eq. 45 with Eq. 23).

    Raises ValueError for wrong shapes or values that are not finite.
    """
    x, v = _split(model, state)
    out = np.zeros(model.n_dof)
    drive = np.r_[vector("torque", torque, model.n_joints, "N m"), np.zeros(6)]  # without disturbances
    dynamics.accelerations(model.constants, make_work(model.constants), x, v, drive, out)
    return out


def mass_matrix(model: Model, state: Sequence[float] | Array) -> Array:
    """Generalised mass matrix (d, d) at a state (2 d,), rotors included (Eq. 46 with Eq. 23).

    Raises ValueError for a wrong shape or values that are not finite.
    """
    x, _ = _split(model, state)
    forces, rest = _inertial_forces(model, weightless=True), np.zeros(model.n_dof)
    matrix = np.array([forces(x, rest, unit) for unit in np.eye(model.n_dof)])
    return (matrix + matrix.T) / 2


def stiffness_matrix(model: Model) -> Array:
    """Stiffness (d, d) of links and joint springs."""
    return _structure(model, model.constants.joint_stiffness, model.constants.stiffness)


def damping_matrix(model: Model) -> Array:
    """Damping (d, d) of links, joint dampers and viscous friction."""
    matrix = _structure(model, model.constants.joint_damping, model.constants.damping)
    matrix[model.motor_columns, model.motor_columns] += model.constants.viscous_friction
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
    from scipy.linalg import eigh

    squares = eigh(stiffness, mass, eigvals_only=True)
    if not lock_joints:
        squares[: model.n_joints] = 0.0  # rounding leaves their square roots at millihertz
    return np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)


def linearize(
    model: Model,
    joint_angles: Sequence[float] | Array | None = None,
    state: Sequence[float] | Array | None = None,
    torque: Sequence[float] | Array | None = None,
) -> LinearModel:
    """The linear model about the undeformed arm at rest at joint angles (n,) rad, or about a whole state (2 d,).

    Angles and torques (n,) in N m are zero by default. Where the accelerations there do not vanish (gravity, speeds),
    x departs from the motion that starts there, and A is the slope at its start. Coulomb friction enters with its slope
    at the rates of the state, which is very steep at rest.

    The balance inertial forces + damping v + stiffness q = torques is differentiated term by term, so that stiff
    springs spoil nothing. Stiffness, damping, B and C are exact, the slope by speeds too (the forces are quadratic in
    them), all up to rounding. The slope of the inertial forces by coordinates is taken by central differences,
    extrapolated to order six, each coordinate in steps that move no section by more than 0.5 % of its link's length or
    0.005 rad. Measured on random chains, bent and fast: it is right to 1e-12 of its largest entry; with the condition
    of the mass matrix on top, A to 1e-10 of its largest (metres and radians weighed by their masses).

    Raises ValueError for wrong shapes, values that are not finite, or a state and joint angles at once.
    """
    from scipy.linalg import cho_factor, cho_solve

    if state is None:
        state = model.initial_state(np.zeros(model.n_joints) if joint_angles is None else joint_angles)
    elif joint_angles is not None:
        raise refusal("state", "given with joint_angles", "one of the two")
    applied = np.zeros(model.n_joints) if torque is None else torque
    (x, v), caused, forces = _split(model, state), acceleration(model, state, applied), _inertial_forces(model)
    d, n, size = model.n_dof, model.n_joints, _coordinate_sizes(model)

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
    mass = mass_matrix(model, state)
    scale = np.sqrt(np.diag(mass))  # metres and radians of fine elements weigh alike
    factor = cho_factor(mass / np.outer(scale, scale))
    slopes = cho_solve(factor, demands / scale[:, None]) / scale[:, None]
    return LinearModel(
        A=np.block([[np.zeros((d, d)), np.eye(d)], [slopes[:, : 2 * d]]]),
        B=np.vstack([np.zeros((d, n)), slopes[:, 2 * d :]]),
        C=np.hstack([tip_jacobian(model, x), np.zeros((3, d))]),
        D=np.zeros((3, n)),
    )


def tip_acceleration(model: Model, state: Sequence[float] | Array, torque: Sequence[float] | Array) -> Array:
    """Acceleration (3,) of the tip in the base frame, m/s^2, at a state (2 d,) under motor torques (n,) in N m.

    It is the second derivative of the tip's position (Eq. 32, 33), exact up to rounding; an accelerometer on the tip
    would show it less gravity.

    Raises ValueError for wrong shapes or values that are not finite.
    """
    (x, v), rates = _split(model, state), acceleration(model, state, torque)
    weightless = model.constants._replace(gravity=np.zeros(3))
    work = make_work(weightless)
    inverse.inertial_forces(weightless, work, x, v, rates, np.zeros(model.n_dof))
    linear, angular = np.split(work.frame_acceleration[-1], 2)  # of the last link, in its frame
    linear = linear + np.cross(angular, work.tip[-1]) + work.tip_bias[-1, :3]
    columns = model.elastic_columns(model.n_joints - 1)
    linear = linear + rates[columns] @ work.tip_shape[len(work.tip_shape) - (columns.stop - columns.start) :, :3]
    for rotation in work.rotation.reshape(-1, 3, 3)[::-1]:
        linear = rotation @ linear
    return linear


def inverse_dynamics(
    model: Model,
    joint_angles: Sequence[float] | Array,
    joint_rates: Sequence[float] | Array,
    joint_accelerations: Sequence[float] | Array,
    joint_jerks: Sequence[float] | Array | None = None,
    joint_snaps: Sequence[float] | Array | None = None,
) -> Array:
    """Motor torques (n,) in N m that give an arm of rigid links a motion of its joints (link side), (n,) each.

    Rigid joints need the motion up to rad/s^2 only, rotors included, exact up to rounding. With flexible joints (Spong,
    Modeling and control of elastic joint robots, 1987) the motors run ahead by the torque on the links over the
    stiffness, so that their acceleration takes its second derivative, and that the jerks (rad/s^3) and snaps (rad/s^4).
    It is differenced along the motion, extrapolated to order six; measured on random chains, the torques are right to
    1e-10 of the largest.

    Raises ValueError for wrong shapes, values that are not finite, missing jerks or snaps, a flexible link, and for a
    flexible joint with a damper (the motor angle is then the solution of a differential equation), with friction of its
    motor or with a spinning rotor.
    """
    n, constants = model.n_joints, model.constants
    motion = np.zeros((5, n))
    given = (joint_angles, joint_rates, joint_accelerations, joint_jerks, joint_snaps)
    names = ("joint_angles", "joint_rates", "joint_accelerations", "joint_jerks", "joint_snaps")
    for order, (name, values) in enumerate(zip(names, given, strict=True)):
        if order < 3 or model.n_motors > 0 or values is not None:
            motion[order] = vector(name, values, n, "rad" if order == 0 else f"rad/s^{order}".removesuffix("^1"))
    if model.n_elastic > 0:
        allowed = "False: bending links have no motion of joints that decides the torques"
        raise refusal("model.choice.flexible_links", model.choice.flexible_links, allowed)
    sprung = constants.motor >= 0
    for i in np.flatnonzero(sprung & (constants.joint_damping > 0.0)):
        raise refusal(
            f"model.arm.joints[{i}].damping", float(constants.joint_damping[i]), "0 where joints are flexible"
        )
    for name in ("viscous_friction", "coulomb_friction"):
        for i in np.flatnonzero(sprung & (getattr(constants, name) > 0.0)):
            raise refusal(f"model.arm.joints[{i}].{name}", float(getattr(constants, name)[i]), "0 with flexible joints")
    if (sprung & (constants.carried_inertia > 0.0)).any():
        raise refusal("model.choice.spinning_rotors", True, "False where joints are flexible")
    forces, spread = _inertial_forces(model), np.zeros((model.n_dof, n))
    spread[np.arange(n), np.arange(n)] = 1.0  # rotors on springs stand still: their share is added below

    def link_torques(t: float) -> Array:
        powers = t ** np.arange(5) / np.array([1.0, 1.0, 2.0, 6.0, 24.0])
        angles, rates, accelerations = (powers[: 5 - order] @ motion[order:] for order in range(3))
        return forces(spread @ angles, spread @ rates, spread @ accelerations)[:n]

    torques = link_torques(0.0) + constants.viscous_friction * motion[1]
    torques += constants.coulomb_friction * np.tanh(motion[1] / constants.coulomb_rate)
    if model.n_motors == 0:
        return torques
    quickest = max(np.abs(row).sum() ** (1 / order) for order, row in enumerate(motion[1:], start=1))
    runs_ahead = _bend(link_torques, SECOND_STEP / max(quickest, 1e-3))[sprung] / constants.joint_stiffness[sprung]
    torques[sprung] += constants.rotor_inertia[sprung] * (motion[2, sprung] + runs_ahead)
    return torques


def _split(model: Model, state: Sequence[float] | Array) -> tuple[Array, Array]:
    values = np.array(vector("state", state, 2 * model.n_dof))
    return values[: model.n_dof], values[model.n_dof :]


def _structure(model: Model, joints: Array, links: Array) -> Array:
    """Matrix (d, d) of what acts between motors and joints, (n,), and in the links, packed blocks."""
    starts = model.constants.square_start
    matrix = np.zeros((model.n_dof, model.n_dof))
    for i, motor in enumerate(model.constants.motor):
        if motor >= 0:
            matrix[np.ix_([i, motor], [i, motor])] = joints[i] * np.array([[1, -1], [-1, 1]])
        columns = model.elastic_columns(i)
        size = columns.stop - columns.start
        matrix[columns, columns] = links[starts[i] : starts[i + 1]].reshape(size, size)
    return matrix


def _inertial_forces(model: Model, weightless: bool = False) -> Callable[[Array, Array, Array], Array]:
    """The forces (d,) that coordinates, speeds and accelerations (d,) demand, with gravity or without."""
    constants = model.constants._replace(gravity=np.zeros(3)) if weightless else model.constants
    work = make_work(constants)

    def forces(x: Array, v: Array, rates: Array) -> Array:
        out = np.zeros(model.n_dof)
        inverse.inertial_forces(constants, work, x, v, rates, out)
        return out

    return forces


def _coordinate_sizes(model: Model) -> Array:
    """(d,) of each coordinate what turns a section by 1 rad or moves it by the length of its link."""
    sizes = np.ones(model.n_dof)
    for i, (link, basis) in enumerate(zip(model.arm.links, model.bases, strict=True)):
        moved = np.abs(basis).reshape(len(basis) // NODE_COORDINATES, 2, 3, basis.shape[1])
        largest = np.maximum(moved[:, 0] / link.length, moved[:, 1]).max(axis=(0, 1), initial=0.0)
        sizes[model.elastic_columns(i)] = 1.0 / largest
    return sizes


def tip_jacobian(model: Model, x: Array) -> Array:
    """(3, d) tip velocity per unit speed."""
    rows = np.zeros((model.n_dof, OUTPUTS))
    work = make_work(model.constants)
    for row, unit in zip(rows, np.eye(model.n_dof), strict=True):
        outputs.observe(model.constants, work, x, unit, row)
    return rows[:, TIP_VELOCITY].T


def _slope(function: Callable[[float], Array], h: float) -> Array:
    """First derivative at 0."""
    parts = [weight / (2 * k * h) * (function(k * h) - function(-k * h)) for k, weight in RICHARDSON]
    return np.sum(parts, axis=0)


def _bend(function: Callable[[float], Array], h: float) -> Array:
    """Second derivative at 0."""
    middle = 2.0 * function(0.0)
    parts = [weight / (k * h) ** 2 * (function(k * h) - middle + function(-k * h)) for k, weight in RICHARDSON]
    return np.sum(parts, axis=0)
