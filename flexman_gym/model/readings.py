"""Readings: what is read of an arm, by name and unit, as rows on its coordinates, speeds and accelerations."""

from collections.abc import Callable

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import one_of, refusal, sequence
from flexman_gym.kernels import outputs
from flexman_gym.kernels.layout import OUTPUTS, TIP_VELOCITY, make_work
from flexman_gym.model.instant import inertial_forces, split_state, tip_jacobian
from flexman_gym.model.model import Model
from flexman_gym.model.slopes import coordinate_slopes
from flexman_gym.model.strain import root_gauges

UNITS = {
    "motor_angles": "rad", "motor_rates": "rad/s", "joint_twists": "rad", "joint_twist_rates": "rad/s",
    "link_deflections": "m", "link_deflection_rates": "m/s", "root_strains": "1",
}  # fmt: skip
ENDS = {1: ("",), 2: ("_y", "_z"), 3: ("_y", "_z", "_torsion")}  # of names, by how many numbers a joint or link has
OUTPUT_UNITS = UNITS | {
    "joint_angles": "rad", "joint_rates": "rad/s", "tip": "m", "tip_velocity": "m/s", "tip_acceleration": "m/s^2",
}  # fmt: skip
INPUT_UNITS = {"motor_torques": "N m", "tip_force": "N", "base_acceleration": "m/s^2"}


def reading_rows(model: Model) -> dict[str, Array]:
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
    return dict(zip(UNITS, [*parts, root_gauges(model).T], strict=True))


def names_of(name: str, unit: str, size: int, joints: int) -> list[str]:
    """Gives the names of the numbers of a quantity with its unit: "motor_angle_1 (rad)"; joints count from 1."""
    if size == 3 and name.startswith(("tip", "base")):
        return [f"{name}_{axis} ({unit})" for axis in "xyz"]
    return [
        f"{name.removesuffix('s')}_{joint}{end} ({unit})"
        for joint in range(1, joints + 1)
        for end in ENDS[size // joints]
    ]


def output_rows(model: Model, state: Vector, rates: Array, names: object) -> tuple[Array, list[str]]:
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
    known, parts, heads = reading_rows(model), [], []
    for i, given in enumerate(sequence("outputs", names, "names")):
        name = one_of(f"outputs[{i}]", given, OUTPUT_UNITS)
        if name in known:
            rows = np.hstack([known[name], np.zeros((len(known[name]), d))])
        elif name in ("joint_angles", "joint_rates"):
            rows = np.roll(np.eye(n, 3 * d), d * (name == "joint_rates"), axis=1)
        else:
            rows = _tip_rows(model, name, x, v, rates)
        parts.append(rows)
        heads += names_of(name, OUTPUT_UNITS[name], len(rows), n)
    return np.vstack([np.zeros((0, 3 * d)), *parts]), heads


def _tip_rows(model: Model, name: str, x: Array, v: Array, rates: Array) -> Array:
    """Gives rows (3, 3 d) of the tip, its velocity J v or its acceleration J a + J' v."""
    d, rows = model.n_dof, np.zeros((3, 3 * model.n_dof))
    order = ("tip", "tip_velocity", "tip_acceleration").index(name)
    rows[:, order * d : (order + 1) * d] = tip_jacobian(model, x)
    moving = (np.zeros(d), v, rates)[order]
    if order == 2 and v.any():
        raise refusal("outputs", name, "outputs without the acceleration of the tip about a state that moves")
    if moving.any():
        work, row = make_work(model.constants), np.zeros(OUTPUTS)

        def velocity(place: Array) -> Array:
            outputs.observe(model.constants, work, place, moving, row)
            return row[TIP_VELOCITY].copy()

        rows[:, :d] += coordinate_slopes(model, velocity, x)
    return rows


def input_columns(model: Model, x: Array, names: object) -> tuple[Array, list[str]]:
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
        raise refusal("inputs", names, f"at least one of {', '.join(INPUT_UNITS)}")
    columns = [makers[name]() for name in given]
    heads = [names_of(name, INPUT_UNITS[name], part.shape[1], n) for name, part in zip(given, columns, strict=True)]
    return np.hstack(columns), [head for each in heads for head in each]


def _weight(model: Model, x: Array, axis: Array) -> Array:
    """Gives the forces (d,) of a base that accelerates along an axis: those that hold the arm in gravity along it."""
    rest = np.zeros(model.n_dof)
    return inertial_forces(model, axis)(x, rest, rest)
