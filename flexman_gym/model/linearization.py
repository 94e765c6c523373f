"""Linearization of an arm about a state: Jacobians by coordinates and speeds, named inputs and outputs.

The balance inertial forces + damping v + stiffness q = torques is differentiated term by term, so that stiff
springs spoil nothing. Stiffness, damping, B and C are exact up to rounding. The Jacobian by speeds is exact too, as
the forces are quadratic in them.

The Jacobian of the inertial forces by coordinates is taken by central differences, extrapolated to order six. No step
moves a section by more than 0.5 % of its link's length or 0.005 rad. On random chains, bent and fast, its measured
error is 1e-12 of its largest entry. With the condition of the mass matrix on top, the error of A is 1e-10 of its
largest entry (metres and radians weighed by their masses).

Coulomb friction c of a motor that slides is a constant torque and damps no small departure: it has no part in A. The
smoothed law c tanh(rate / coulomb_rate) has the slope c / coulomb_rate at rest, a damper of a hundred times c by
default. A model with that slope holds for rates far below `coulomb_rate` alone, where the motor hardly moves; no gain
or margin may be designed on it.
"""

from collections.abc import Callable, Sequence

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, Vector
from flexman_gym.common.checks import check_solvable, one_of, sequence, value_error
from flexman_gym.kernels import outputs
from flexman_gym.kernels.control_period import sparse_product
from flexman_gym.kernels.layout import OUTPUTS, TIP_VELOCITY, make_work
from flexman_gym.model.deformation import root_strain_matrix
from flexman_gym.model.dynamics import (
    RICHARDSON,
    acceleration,
    damping_matrix,
    inertial_forces,
    mass_matrix,
    split_state,
    stiffness_matrix,
    tip_jacobian,
)
from flexman_gym.model.element import NODE_COORDINATES
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.state_space import LinearModel, SecondOrderForm

FIRST_STEP = 0.005  # rad, for a first derivative: its truncation is just below rounding


def _coordinate_jacobian(model: Model, function: Callable[[Array], Array], x: Array) -> Array:
    """Gives slopes (m, d) by the coordinates of a function (m,) of them, by differences extrapolated to order six.

    No step moves a section by more than 0.5 % of its link's length or 0.005 rad.

    Args:
        model: the model.
        function: of coordinates (d,).
        x: (d,) where the slopes are taken.
    """
    size = coordinate_scales(model)

    def slope(unit: Array) -> Array:
        h = FIRST_STEP
        parts = [
            weight / (2 * k * h) * (function(x + k * h * unit) - function(x - k * h * unit)) for k, weight in RICHARDSON
        ]
        return np.sum(parts, axis=0)

    return np.transpose([slope(unit) for unit in np.diag(size)]) / size


def coordinate_scales(model: Model) -> Array:
    """Gives the size (d,) of each coordinate that turns a section by 1 rad or moves it by the length of its link."""
    sizes = np.ones(model.n_dof)
    for i, (link, basis) in enumerate(zip(model.arm.links, model.bases, strict=True)):
        moved = np.abs(basis).reshape(len(basis) // NODE_COORDINATES, 2, 3, basis.shape[1])
        largest = np.maximum(moved[:, 0] / link.length, moved[:, 1]).max(axis=(0, 1), initial=0.0)
        sizes[model.elastic_columns(i)] = 1.0 / largest
    return sizes


MEASUREMENT_UNITS = {
    "motor_angles": "rad", "motor_rates": "rad/s", "joint_twists": "rad", "joint_twist_rates": "rad/s",
    "link_deflections": "m", "link_deflection_rates": "m/s", "root_strains": "1",
}  # fmt: skip
ENDS = {1: ("",), 2: ("_y", "_z"), 3: ("_y", "_z", "_torsion")}  # of names, by how many numbers a joint or link has
OUTPUT_UNITS = MEASUREMENT_UNITS | {
    "joint_angles": "rad", "joint_rates": "rad/s", "tip": "m", "tip_velocity": "m/s", "tip_acceleration": "m/s^2",
}  # fmt: skip
INPUT_UNITS = {"motor_torques": "N m", "tip_force": "N", "base_acceleration": "m/s^2"}


def _measurement_rows(model: Model) -> dict[str, Array]:
    """Gives what reads each of UNITS from a state, (m, 2 d), by name.

    Args:
        model: the model.
    """
    n, d = model.n_joints, model.n_dof
    bending = np.zeros((2 * n, 2 * d))
    for i in range(n):
        start, stop = model.constants.elastic_start[i : i + 2]
        bending[2 * i : 2 * i + 2, model.elastic_columns(i)] = model.constants.tip_translation[start:stop, 1:].T
    angles = np.eye(2 * d)[model.motor_columns]
    twist = angles - np.eye(2 * d)[:n]
    parts = [each for part in (angles, twist, bending) for each in (part, np.roll(part, d, axis=1))]
    return dict(zip(MEASUREMENT_UNITS, [*parts, root_strain_matrix(model).T], strict=True))


def column_names(name: str, unit: str, size: int, joints: int) -> list[str]:
    """Gives the names of the numbers of a quantity with its unit: "motor_angle_1 (rad)"; joints count from 1."""
    if size == 3 and name.startswith(("tip", "base")):
        return [f"{name}_{axis} ({unit})" for axis in "xyz"]
    return [
        f"{name.removesuffix('s')}_{joint}{end} ({unit})"
        for joint in range(1, joints + 1)
        for end in ENDS[size // joints]
    ]


LINEAR_SENSORS = {  # name of a sensor whose readings are linear in the state -> what it measures
    "motor_encoders": ("motor_angles", "motor_rates"),
    "joint_encoders": ("joint_twists", "joint_twist_rates"),  # on both sides of a spring
    "strain": ("root_strains",),
}


class LinearMeasurements:
    """How a model of n links is read.

    Attributes:
        motion: what gives motor_angles, motor_rates, joint_twists, joint_twist_rates, (n,) each, link_deflections and
            link_deflection_rates, (2 n,) each, side by side.
        places: name -> slice of these 8 n numbers.
        strains: what gives root_strains, (3 n,), see `model.deformation.root_strain_matrix`.
    """

    def __init__(self, model: Model) -> None:
        *parts, strains = _measurement_rows(model).values()
        ends = np.cumsum([0, *map(len, parts)]).tolist()
        self.places = {name: slice(*both) for name, *both in zip(MEASUREMENT_UNITS, ends, ends[1:], strict=False)}
        self.motion = _entries(np.vstack(parts))
        self.strains = _entries(strains)

    def named(self, states: Array) -> dict[str, Array]:
        """Gives all readings (T, ...) of states (T, 2 d) by name."""
        motion = np.zeros((len(states), max(place.stop for place in self.places.values())))
        strains = np.zeros((len(states), len(self.strains[0]) - 1))
        rows = np.ascontiguousarray(states)
        sparse_product(rows, *self.motion, motion)
        sparse_product(rows, *self.strains, strains)
        return {name: motion[:, place] for name, place in self.places.items()} | {"root_strains": strains}


def _entries(rows: Array) -> tuple[IntArray, IntArray, Array]:
    """The rows (m, 2 d) of a linear reading without their zeros, most of it, as `sparse_product` takes them."""
    start: IntArray = np.append(0, np.cumsum(np.count_nonzero(rows, axis=1)))
    source: IntArray = np.nonzero(rows)[1]
    return start, source, rows[rows != 0.0]


def _output_rows(model: Model, state: Vector, rates: Array, names: object) -> tuple[Array, list[str]]:
    """Gives rows (p, 3 d) that read outputs from coordinates, speeds and accelerations near a state, and their names.

    Args:
        model: the model.
        state: (2 d,).
        rates: (d,) the accelerations at the state.
        names: of OUTPUT_UNITS.

    Raises:
        ValueError: for other names, and for the acceleration of the tip where the arm moves.
    """
    n, d, (x, v) = model.n_joints, model.n_dof, split_state(model, state)
    known, parts, heads = _measurement_rows(model), [], []
    for i, given in enumerate(sequence("outputs", names, "names")):
        name = one_of(f"outputs[{i}]", given, OUTPUT_UNITS)
        if name in known:
            rows = np.hstack([known[name], np.zeros((len(known[name]), d))])
        elif name in ("joint_angles", "joint_rates"):
            rows = np.roll(np.eye(n, 3 * d), d * (name == "joint_rates"), axis=1)
        else:
            rows = _tip_rows(model, name, x, v, rates)
        parts.append(rows)
        heads += column_names(name, OUTPUT_UNITS[name], len(rows), n)
    return np.vstack([np.zeros((0, 3 * d)), *parts]), heads


def _tip_rows(model: Model, name: str, x: Array, v: Array, rates: Array) -> Array:
    """Gives rows (3, 3 d) of the tip, its velocity J v or its acceleration J a + J' v."""
    d, rows = model.n_dof, np.zeros((3, 3 * model.n_dof))
    order = ("tip", "tip_velocity", "tip_acceleration").index(name)
    rows[:, order * d : (order + 1) * d] = tip_jacobian(model, x)
    moving = (np.zeros(d), v, rates)[order]
    if order == 2 and v.any():
        raise value_error("outputs", name, "outputs without the acceleration of the tip about a state that moves")
    if moving.any():
        work, row = make_work(model.constants), np.zeros(OUTPUTS)

        def velocity(place: Array) -> Array:
            outputs.compute_outputs(model.constants, work, place, moving, row)
            return row[TIP_VELOCITY].copy()

        rows[:, :d] += _coordinate_jacobian(model, velocity, x)
    return rows


def _input_columns(model: Model, x: Array, names: object) -> tuple[Array, list[str]]:
    """Gives the generalised forces (d, m) of unit inputs at coordinates (d,), and the names of the inputs.

    Args:
        model: the model.
        x: (d,).
        names: of INPUT_UNITS.

    Raises:
        ValueError: for other names, and for none.
    """
    n, d = model.n_joints, model.n_dof
    makers: dict[str, Callable[[], Array]] = {
        "motor_torques": lambda: np.eye(d)[:, model.motor_columns],
        "tip_force": lambda: tip_jacobian(model, x).T,
        "base_acceleration": lambda: np.transpose([_weight(model, x, axis) for axis in np.eye(3)]),
    }
    given = [one_of(f"inputs[{i}]", name, INPUT_UNITS) for i, name in enumerate(sequence("inputs", names, "names"))]
    if not given:
        raise value_error("inputs", names, f"at least one of {', '.join(INPUT_UNITS)}")
    columns = [makers[name]() for name in given]
    heads = [column_names(name, INPUT_UNITS[name], part.shape[1], n) for name, part in zip(given, columns, strict=True)]
    return np.hstack(columns), [head for each in heads for head in each]


def _weight(model: Model, x: Array, axis: Array) -> Array:
    """Gives the forces (d,) of a base that accelerates along an axis: those that hold the arm in gravity along it."""
    rest = np.zeros(model.n_dof)
    return inertial_forces(model, axis)(x, rest, rest)


SLIDING, AT_REST = "sliding", "at rest"  # Coulomb friction in a linear model


def linearize(
    model: Model,
    joint_angles: Vector | None = None,
    state: Vector | None = None,
    torque: Vector | None = None,
    outputs: Sequence[str] = ("tip",),
    inputs: Sequence[str] = ("motor_torques",),
    friction: str = SLIDING,
) -> LinearModel:
    """Gives the linear model about the undeformed arm at rest, or about a whole state.

    States x (2 d,) are coordinates and speeds in the order of `kernels.layout`. Where the accelerations at the state do
    not vanish (gravity, speeds), x departs from the motion that starts there, and A is the slope at its start. Coulomb
    friction of a sliding motor, the default, is constant and has no slope.

    Args:
        model: the model.
        joint_angles: (n,) rad, zero by default.
        state: (2 d,), in place of joint angles.
        torque: (n,) of the motors, N m, zero by default.
        outputs: what y reads: "tip", "tip_velocity" and "tip_acceleration" (3 numbers each, in the base frame and
            relative to the base), "joint_angles", "joint_rates", "motor_angles", "motor_rates", "joint_twists",
            "joint_twist_rates" (n each), "link_deflections", "link_deflection_rates" (2 n), "root_strains" (3 n).
        inputs: what u holds: "motor_torques" (n), "tip_force" (3) and "base_acceleration" (3).
        friction: "sliding", or "at rest" for the slope of the smoothed Coulomb friction at the rates of the state.

    Raises:
        ValueError: for wrong shapes, values that are not finite, a state and joint angles at once, unknown names, and
            the acceleration of the tip about a state that moves.

    Examples:
        >>> system = fm.linearize(fm.build_model(fm.catalog.one_joint()), outputs=("tip",))
        >>> system.A.shape, system.B.shape, system.outputs
        ((28, 28), (28, 1), ('tip_x (m)', 'tip_y (m)', 'tip_z (m)'))
        >>> system.discrete(period=0.01).period
        0.01
    """
    check_model(model)
    if state is None:
        state = model.initial_state(np.zeros(model.n_joints) if joint_angles is None else joint_angles)
    elif joint_angles is not None:
        raise value_error("state", "given with joint_angles", "one of the two")
    applied = np.zeros(model.n_joints) if torque is None else torque
    caused = acceleration(model, state, applied)
    columns, driven = _input_columns(model, split_state(model, state)[0], inputs)
    demands = np.hstack([_demands(model, state, caused), columns])
    if one_of("friction", friction, (SLIDING, AT_REST)) == AT_REST:
        _add_coulomb_slopes(model, state, demands)
    rows, read = _output_rows(model, state, caused, outputs)
    return _linear_model(model, SecondOrderForm(mass_matrix(model, state), demands, rows), tuple(driven), tuple(read))


def _linear_model(
    model: Model, balance: SecondOrderForm, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> LinearModel:
    """Gives the linear model of a balance of forces."""
    from scipy.linalg import cho_factor, cho_solve

    (mass, demands, rows), d = balance, model.n_dof
    scale = np.sqrt(np.diag(mass))  # metres and radians of fine elements weigh alike
    with check_solvable("accelerations"):
        factor = cho_factor(mass / np.outer(scale, scale))
        slopes = cho_solve(factor, demands / scale[:, None]) / scale[:, None]
    felt = rows[:, 2 * d :] @ slopes
    return LinearModel(
        A=np.block([[np.zeros((d, d)), np.eye(d)], [slopes[:, : 2 * d]]]),
        B=np.vstack([np.zeros((d, len(inputs))), slopes[:, 2 * d :]]),
        C=rows[:, : 2 * d] + felt[:, : 2 * d],
        D=felt[:, 2 * d :],
        states=_state_names(model),
        inputs=inputs,
        outputs=outputs,
        balance=balance,
    )


def _state_names(model: Model) -> tuple[str, ...]:
    """Gives the names (2 d,) of coordinates and speeds; elastic coordinates have the units of their nodes or modes."""
    joints, motors = range(1, model.n_joints + 1), np.flatnonzero(model.constants.motor >= 0) + 1
    elastic = [
        f"link_{i + 1}_elastic_{a + 1}"
        for i in range(model.n_joints)
        for a in range(model.elastic_columns(i).stop - model.elastic_columns(i).start)
    ]
    return tuple(
        name
        for kind, unit in (("angle", "rad"), ("rate", "rad/s"))
        for name in [
            *(f"joint_{kind}_{i} ({unit})" for i in joints),
            *(f"motor_{kind}_{i} ({unit})" for i in motors),
            *(each if kind == "angle" else f"{each}_rate" for each in elastic),
        ]
    )


def _demands(model: Model, state: Vector, caused: Array) -> Array:
    """Gives slopes (d, 2 d), by coordinates and speeds, of the forces that accelerate the arm by `caused` (d,)."""
    (x, v), forces = split_state(model, state), inertial_forces(model)
    d, size = model.n_dof, coordinate_scales(model)

    def by_speed(unit: Array) -> Array:
        return (forces(x, v + unit, caused) - forces(x, v - unit, caused)) / 2

    demands = np.zeros((d, 2 * d))
    demands[:, :d] = -stiffness_matrix(model) - _coordinate_jacobian(model, lambda place: forces(place, v, caused), x)
    demands[:, d:] = -damping_matrix(model) - np.transpose([by_speed(unit) for unit in np.diag(size)]) / size
    return demands


def _add_coulomb_slopes(model: Model, state: Vector, demands: Array) -> None:
    """Subtract the slopes of the smoothed Coulomb friction by the motor rates from demands (d, 2 d + m)."""
    motors, constants = model.motor_columns, model.constants
    steepness = constants.coulomb_friction / constants.coulomb_rate
    parts = np.abs(split_state(model, state)[1][motors] / constants.coulomb_rate)
    # beyond 300 the slope is 0 and cosh overflows
    demands[motors, model.n_dof + motors] -= steepness / np.cosh(np.minimum(parts, 300.0)) ** 2
