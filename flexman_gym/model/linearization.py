"""Linearisation of an arm about a state: Jacobians by coordinates and speeds, named inputs and outputs.

The equations of motion, inertial forces + damping v + stiffness q = torques, are differentiated term by term, so that
stiff springs cause no loss of accuracy. Forward-mode differentiation of the kernels, see `kernels.tangents`, makes all
Jacobians exact to rounding. The condition number of the mass matrix (metres and radians weighted by their masses)
amplifies the rounding errors in A and B.

Joint springs with backlash or stiffness pieces have the tangent stiffness at the twist of the state: none within the
gap, so take a state at rest under load (`statics.rest_state`). Torque ripple has no slope: it is a disturbance.

Coulomb friction c of a sliding motor is a constant torque and does not contribute to A. The smoothed friction torque
c tanh(rate / coulomb_rate) has the slope c / coulomb_rate at rest, by default 100 c (N m s/rad). A model with this
slope is valid only for rates far below `coulomb_rate`, where the motor hardly moves; it is not suitable for the design
of gains or margins.
"""

from collections.abc import Callable, Sequence

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, Vector
from flexman_gym.common.checks import check_solvable, one_of, sequence
from flexman_gym.common.errors import value_error
from flexman_gym.kernels.control_period import sparse_product
from flexman_gym.model.deformation import root_strain_matrix
from flexman_gym.model.dynamics import (
    acceleration,
    damping_matrix,
    inertial_forces,
    inertial_jacobian,
    split_state,
    stiffness_matrix,
)
from flexman_gym.model.element import NODE_COORDINATES
from flexman_gym.model.friction import coulomb_slopes
from flexman_gym.model.model import Model
from flexman_gym.model.state_space import LinearModel, SecondOrderForm


def coordinate_scales(model: Model) -> Array:
    """Return the scale (d,) of each coordinate: its value at which a node rotates by 1 rad or moves by the link length.

    Args:
        model: model of the arm.
    """
    sizes = np.ones(model.n_dof)
    for i, (link, basis) in enumerate(zip(model.arm.links, model.bases, strict=True)):
        motions = np.abs(basis).reshape(len(basis) // NODE_COORDINATES, 2, 3, basis.shape[1])
        largest = np.maximum(motions[:, 0] / link.length, motions[:, 1]).max(axis=(0, 1), initial=0.0)
        sizes[model.elastic_columns(i)] = 1.0 / largest
    return sizes


MEASUREMENT_UNITS = {
    "motor_angles": "rad", "motor_rates": "rad/s", "joint_twists": "rad", "joint_twist_rates": "rad/s",
    "link_deflections": "m", "link_deflection_rates": "m/s", "root_strains": "1",
}  # fmt: skip
SUFFIXES = {1: ("",), 2: ("_y", "_z"), 3: ("_y", "_z", "_torsion")}  # number of entries per joint or link -> suffixes
OUTPUT_UNITS = MEASUREMENT_UNITS | {
    "joint_angles": "rad", "joint_rates": "rad/s", "tip": "m", "tip_velocity": "m/s", "tip_acceleration": "m/s^2",
}  # fmt: skip
INPUT_UNITS = {"motor_torques": "N m", "tip_force": "N", "base_acceleration": "m/s^2"}


def input_columns(model: Model, name: str) -> range:
    """Return the columns (m,) of an input of INPUT_UNITS among the n + 6 inputs of the kernels."""
    n = model.n_joints
    return {"motor_torques": range(n), "tip_force": range(n, n + 3), "base_acceleration": range(n + 3, n + 6)}[name]


def measurement_rows(model: Model) -> dict[str, Array]:
    """Return name -> matrix (m, 2 d) of each measurement in MEASUREMENT_UNITS, the Jacobian by the state."""
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
    """Return column names with units, such as "motor_angle_1 (rad)"; joints are numbered from 1.

    Args:
        name: name of a measurement, output or input, such as "motor_angles".
        unit: unit of its entries.
        size: number of its entries.
        joints: number of joints of the arm.
    """
    if size == 3 and name.startswith(("tip", "base")):
        return [f"{name}_{axis} ({unit})" for axis in "xyz"]
    return [
        f"{name.removesuffix('s')}_{joint}{suffix} ({unit})"
        for joint in range(1, joints + 1)
        for suffix in SUFFIXES[size // joints]
    ]


LINEAR_SENSORS = {  # sensor whose output is linear in the state -> its measurements
    "motor_encoders": ("motor_angles", "motor_rates"),
    "joint_encoders": ("joint_twists", "joint_twist_rates"),  # encoders on both sides of the joint spring
    "strain": ("root_strains",),
}
LINK_SENSOR = {"link_encoders": ("joint_angles",)}  # sensor of the link side alone, without rates; never a default


class LinearMeasurements:
    """Measurements of an arm with n links that are linear in its state.

    Attributes:
        columns: measurement -> slice of the 8 n columns of the product of `motion` with states: motor_angles,
            motor_rates, joint_twists (elastic deflections of the joints: motor angles minus link-side angles, rad),
            joint_twist_rates, n columns each, link_deflections, link_deflection_rates, 2 n columns each.
        motion: sparse matrix (8 n, 2 d) of these measurements, for the kernel `sparse_product`.
        strains: sparse matrix (3 n, 2 d) of root_strains, see `model.deformation.root_strain_matrix`.
    """

    def __init__(self, model: Model) -> None:
        """Assemble the sparse matrices.

        Args:
            model: model of the arm.
        """
        *parts, strains = measurement_rows(model).values()
        ends = np.cumsum([0, *map(len, parts)]).tolist()
        self.columns = {name: slice(*both) for name, *both in zip(MEASUREMENT_UNITS, ends, ends[1:], strict=False)}
        self.motion = sparse_rows(np.vstack(parts))
        self.strains = sparse_rows(strains)

    def measure(self, states: Array) -> dict[str, Array]:
        """Return measurement -> values (T, n), (T, 2 n) or (T, 3 n) for states (T, 2 d); see MEASUREMENT_UNITS."""
        motion = np.zeros((len(states), max(place.stop for place in self.columns.values())))
        strains = np.zeros((len(states), len(self.strains[0]) - 1))
        rows = np.ascontiguousarray(states)
        sparse_product(rows, *self.motion, motion)
        sparse_product(rows, *self.strains, strains)
        return {name: motion[:, place] for name, place in self.columns.items()} | {"root_strains": strains}


def sparse_rows(rows: Array) -> tuple[IntArray, IntArray, Array]:
    """Return row starts, column indices and values of the non-zero entries of a matrix, for `sparse_product`."""
    start: IntArray = np.append(0, np.cumsum(np.count_nonzero(rows, axis=1)))
    source: IntArray = np.ascontiguousarray(np.nonzero(rows)[1])
    return start, source, rows[rows != 0.0]


def _output_rows(model: Model, motion: Array, tip: Array, names: object) -> tuple[Array, list[str]]:
    """Return the matrix (p, 3 d) from coordinates, speeds and accelerations near a motion to outputs, and their names.

    Args:
        model: model of the arm.
        motion: (3, d) coordinates, speeds and accelerations.
        tip: (3, 3 d) Jacobian of the tip velocity with respect to the motion.
        names: names of outputs in OUTPUT_UNITS; "tip_acceleration" requires zero speeds.
    """
    n, d = model.n_joints, model.n_dof
    measurements, parts, labels = measurement_rows(model), [], []
    for i, given in enumerate(sequence("outputs", names, "names")):
        name = one_of(f"outputs[{i}]", given, OUTPUT_UNITS)
        if name in measurements:
            rows = np.hstack([measurements[name], np.zeros((len(measurements[name]), d))])
        elif name in ("joint_angles", "joint_rates"):
            rows = np.roll(np.eye(n, 3 * d), d * (name == "joint_rates"), axis=1)
        else:
            rows = _tip_rows(model, name, motion, tip)
        parts.append(rows)
        labels += column_names(name, OUTPUT_UNITS[name], len(rows), n)
    return np.vstack([np.zeros((0, 3 * d)), *parts]), labels


def _tip_rows(model: Model, name: str, motion: Array, tip: Array) -> Array:
    """Return the Jacobian (3, 3 d) of the tip position, velocity J v, or acceleration J a + (dJ/dt) v.

    Motion and Jacobian of the tip velocity as in `_output_rows`.
    """
    d, (x, v, accelerations) = model.n_dof, motion
    if name == "tip_velocity":
        return tip
    rows = np.zeros_like(tip)
    if name == "tip":
        rows[:, :d] = tip[:, d : 2 * d]
        return rows
    if v.any():
        raise value_error("outputs", name, "outputs without the acceleration of the tip, for a moving state")
    # at rest the tip acceleration is the tip velocity for accelerations in the place of speeds
    still = inertial_jacobian(model, np.array([x, accelerations, v]))[d:]
    rows[:, :d], rows[:, 2 * d :] = still[:, :d], still[:, d : 2 * d]
    return rows


def _input_forces(model: Model, x: Array, tip: Array, names: object) -> tuple[Array, list[str]]:
    """Return the generalised forces (d, m) of unit inputs, and the names of the inputs.

    Args:
        model: model of the arm.
        x: (d,) coordinates.
        tip: (3, d) Jacobian of the tip position.
        names: names of inputs in INPUT_UNITS; at least one.
    """
    n, d = model.n_joints, model.n_dof
    rest = np.zeros(d)
    makers: dict[str, Callable[[], Array]] = {
        "motor_torques": lambda: np.eye(d)[:, model.driven_columns],
        "tip_force": lambda: tip.T,
        # an acceleration of the base has the forces of static equilibrium under gravity of the same direction
        "base_acceleration": lambda: np.transpose([inertial_forces(model, axis)(x, rest, rest) for axis in np.eye(3)]),
    }
    kinds = [one_of(f"inputs[{i}]", name, INPUT_UNITS) for i, name in enumerate(sequence("inputs", names, "names"))]
    if not kinds:
        raise value_error("inputs", names, f"at least one of {', '.join(INPUT_UNITS)}")
    columns = [makers[name]() for name in kinds]
    motors = np.array(column_names("motor_torques", INPUT_UNITS["motor_torques"], n, n))[model.constants.passive == 0]
    names = {"motor_torques": motors.tolist()}
    labels = [names[kind] if kind in names else column_names(kind, INPUT_UNITS[kind], 3, n) for kind in kinds]
    return np.hstack(columns), [label for each in labels for label in each]


SLIDING, AT_REST = "sliding", "at rest"  # treatments of Coulomb friction in a linear model


def continuous_model(
    model: Model,
    state: Vector,
    torque: Vector,
    outputs: Sequence[str] = ("tip",),
    inputs: Sequence[str] = ("motor_torques",),
    friction: str = SLIDING,
) -> LinearModel:
    """Return the continuous-time linear model about a state; arguments as in `simulation.linearization.linearize`."""
    motion, d = np.array([*split_state(model, state), acceleration(model, state, torque)]), model.n_dof
    jacobian = inertial_jacobian(model, motion)
    inertial, tip = jacobian[:d], jacobian[d:]
    columns, input_names = _input_forces(model, motion[0], tip[:, d : 2 * d], inputs)
    restoring = np.hstack([stiffness_matrix(model, motion[0]), damping_matrix(model)])
    forces = np.hstack([-restoring - inertial[:, : 2 * d], columns])
    if one_of("friction", friction, (SLIDING, AT_REST)) == AT_REST:
        motors = model.motor_columns
        forces[motors, d + motors] -= coulomb_slopes(model, motion[1][motors])
    rows, output_names = _output_rows(model, motion, tip, outputs)
    mass = inertial[:, 2 * d :]
    second_order = SecondOrderForm((mass + mass.T) / 2.0, forces, rows)
    return _linear_model(model, second_order, tuple(input_names), tuple(output_names))


def _linear_model(
    model: Model, second_order: SecondOrderForm, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> LinearModel:
    """Return the state-space model of the equations of motion in second-order form."""
    from scipy.linalg import cho_factor, cho_solve

    (mass, forces, rows), d = second_order, model.n_dof
    scale = np.sqrt(np.diag(mass))  # equal weights for metres and radians of fine elements
    with check_solvable("accelerations"):
        factor = cho_factor(mass / np.outer(scale, scale))
        jacobian = cho_solve(factor, forces / scale[:, None]) / scale[:, None]
    feedthrough = rows[:, 2 * d :] @ jacobian
    return LinearModel(
        A=np.block([[np.zeros((d, d)), np.eye(d)], [jacobian[:, : 2 * d]]]),
        B=np.vstack([np.zeros((d, len(inputs))), jacobian[:, 2 * d :]]),
        C=rows[:, : 2 * d] + feedthrough[:, : 2 * d],
        D=feedthrough[:, 2 * d :],
        states=_state_names(model),
        inputs=inputs,
        outputs=outputs,
        balance=second_order,
    )


def _state_names(model: Model) -> tuple[str, ...]:
    """Return the names (2 d,) of coordinates and speeds; elastic coordinates have the units of nodes or modes."""
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
