"""Sensitivities: exact derivatives of the motion of a scene with respect to physical parameters and initial state.

The equations of the integration method are differentiated in forward mode by the kernels of the simulation, see
`kernels.tangents`. The derivatives are those of the computed motion, step by step, without differences of motions.

A dimension of a link, its material or a gear ratio changes constants that all arms of a batch share. The node
coordinates of a link per unit of each elastic coordinate do not change with it: the shapes of component modes are held.
Without modes, the elastic coordinates are the node coordinates themselves, and the derivative is that of the complete
finite-element model.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of, sequence
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import ARMS_PER_GROUP, STATUS, Constants
from flexman_gym.model.deformation import root_strain_matrix
from flexman_gym.model.dynamics import RICHARDSON
from flexman_gym.model.linearization import INPUT_UNITS, OUTPUT_UNITS, LinearMeasurements, column_names, input_columns
from flexman_gym.model.model import Model, changed_model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import replace_quietly
from flexman_gym.scene.link import OTHER_AXIS, Link
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.foundation import scene_pieces
from flexman_gym.simulation.integrator import default_step, with_prescribed
from flexman_gym.simulation.methods import METHODS, FixedStepMethod, Method
from flexman_gym.simulation.period_map import DIRECTIONS, TangentIntegrator
from flexman_gym.simulation.physical_parameters import ARM, PARAMETERS, ScalarParameter, select_parts
from flexman_gym.simulation.scene_simulation import initial_row, run_in_lanes, scene_settings

INITIAL = {"initial_joint_angles": "rad", "initial_joint_rates": "rad/s"}  # initial conditions -> unit
RELATIVE_STEP = 1e-2  # relative step of the differences of constants
SMALL_STEP = 1e-3  # in the unit of the parameter; step of the differences at a value of 0
INPUTS = {name: row.unit for name, row in PARAMETERS.items()} | INITIAL | INPUT_UNITS  # parameters -> unit
ENERGIES = {"kinetic_energy": (layout.KINETIC,), "elastic_energy": (layout.LINK_ENERGY, layout.JOINT_ENERGY),
            "gravitational_energy": (layout.GRAVITATIONAL,)}  # fmt: skip
TIP_OUTPUTS = {"tip": layout.TIP, "tip_velocity": layout.TIP_VELOCITY}
OUTPUTS = {name: unit for name, unit in OUTPUT_UNITS.items() if name != "tip_acceleration"} | dict.fromkeys(
    ENERGIES, "J"
)


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Outputs of a scene and their derivatives at T output times; after a failure only at those before the failure.

    Attributes:
        time: (T,) s.
        values: (T, m) outputs.
        jacobian: (T, m, p) derivatives of the outputs with respect to the parameters.
        outputs: m names with units, such as "tip_x (m)".
        parameters: p names with units, such as "joint_stiffness[0] (N m/rad)".
        status: "ok", or "diverged" also if Newton's method does not converge; of an episode "ok" or the cause of its
            failure.
        kinks: number of output intervals in which the motion passed a kink, by name and joint: the rate of a motor with
            Coulomb friction changed its sign ("coulomb_friction[0]"), or the twist of a joint passed a knee of its
            spring, such as an end of its backlash ("joint_stiffness[0]"). The model rounds these kinks over
            `coulomb_rate` and `knee_width`; within them derivatives change fast, and beyond them those of either side
            hold. Several passages in an interval count once, and two that cancel out are not seen. In an episode also
            the command of a motor reached or left its torque limit ("torque_limit[0]"), beyond which derivatives are 0.
    """

    time: Array
    values: Array
    jacobian: Array
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    status: str
    kinks: dict[str, int]

    def __repr__(self) -> str:
        times, outputs, parameters = self.jacobian.shape
        kinks = ", ".join(f"{name} {count}" for name, count in self.kinks.items())
        return (
            f"<Sensitivities: {self.status}, {times} times, {outputs} outputs by {parameters} parameters\n"
            f"  outputs {', '.join(self.outputs)}\n  parameters {', '.join(self.parameters)}"
            + (f"\n  kinks {kinks}>" if kinks else ">")
        )


def sensitivities(
    scene: Scene,
    of: str | Sequence[str] = ("tip",),
    to: str | Sequence[str] = ("payload_mass",),
    model: Model | None = None,
    method: str | Method = "auto",
    step: float | None = None,
) -> Sensitivities:
    """Simulate a scene together with the derivatives of its outputs; arguments as in `evaluation.sensitivities`."""
    step = default_step(scene.output_step) if step is None else step
    settings = scene_settings(scene, model, method, step, 1e-6, 1e-9)
    chosen, model = settings.method, settings.model
    if not isinstance(chosen, FixedStepMethod) or chosen.adaptive or settings.tolerance is not None:
        allowed = [name for name, each in METHODS.items() if not each.adaptive]
        raise value_error("method", chosen.name, f"one of fixed steps: {', '.join(allowed)}")
    names = [one_of("of", name, OUTPUTS) for name in checked_names("of", of)]
    prescribed = scene.prescribed_joints
    directions = [each for name in checked_names("to", to) for each in find_directions(name, model, prescribed)]
    found = _dimension_derivatives(model, directions)
    constants = with_prescribed(found.constants, prescribed, scene.rotates)
    motion, period = _Motion.start(scene, model, directions, settings.rows), (settings.interval, settings.substeps)
    for group in range(-(-len(directions) // DIRECTIONS)):
        integrator = TangentIntegrator(constants, chosen, period, 1, whole=bool(found.strains))
        for lane, number in enumerate(range(len(directions))[group * DIRECTIONS : (group + 1) * DIRECTIONS]):
            direction = directions[number]
            own = constant_derivatives(model, direction) if direction.name in PARAMETERS else found.fields[number]
            integrator.set_derivative(lane, own)
        arms = slice(group * ARMS_PER_GROUP, (group + 1) * ARMS_PER_GROUP)
        ends = run_in_lanes(integrator, motion.drives[arms], settings, motion.rows[arms], motion.outputs[arms])
    return motion.read(names, model, settings.interval, int(ends[0, 1]), found.strains)


@dataclass
class _Drive:
    """Drive table of a derivative, the same in all pieces of the drive of the scene, whose times are `times`."""

    times: Array
    values: Array

    def table(self, interval: int = 0) -> Array:
        """Return the drive table (7, n + 6)."""
        return self.values


class _Motion(NamedTuple):
    """Motion of an arm and its derivatives: an arm and DIRECTIONS derivatives for each group, b together.

    Attributes:
        directions: parameters of the derivatives; unused derivatives of the last group follow them.
        drives: drives of the arms and derivatives.
        rows: (b, T, 2 d + 2) states and energy ledgers.
        outputs: (b, T, OUTPUTS) columns of `kernels.layout`.
    """

    directions: list[ScalarParameter]
    drives: list[Any]
    rows: Array
    outputs: Array

    @classmethod
    def start(cls, scene: Scene, model: Model, directions: list[ScalarParameter], last: int) -> "_Motion":
        """Return the motion before the simulation of `last` output intervals."""
        pieces, lanes = scene_pieces(scene), TangentIntegrator.derivative_rows(len(directions))
        starts, inputs = unit_changes(directions, model)
        groups = -(-len(directions) // DIRECTIONS)
        rows = np.zeros((groups * ARMS_PER_GROUP, last + 1, 2 * model.n_dof + 2))
        rows[::ARMS_PER_GROUP, 0], rows[lanes, 0] = initial_row(scene, model), starts
        tables = np.zeros((len(rows), *pieces.table().shape))
        tables[lanes, layout.OFFSET, : inputs.shape[1]] = inputs
        drives: list[Any] = [_Drive(pieces.times, table) for table in tables]
        drives[::ARMS_PER_GROUP] = [pieces] * groups
        return cls(directions, drives, rows, np.zeros((*rows.shape[:2], layout.OUTPUTS)))

    def read(
        self, names: list[str], model: Model, interval: float, valid: int, strains: dict[int, Array]
    ) -> Sensitivities:
        """Return the outputs of given names and their derivatives at the valid times.

        `strains` are derivatives of the matrix of root strains, by the number of the direction.
        """
        motion = self.rows[:, : valid + 1], self.outputs[:, : valid + 1]
        parts, labels = zip(*(motion_output(name, model, *motion) for name in names), strict=True)
        every, lanes = np.concatenate(parts, axis=2), TangentIntegrator.derivative_rows(len(self.directions))
        ends = np.cumsum([part.shape[2] for part in parts])
        for name, end in zip(names, ends.tolist(), strict=True):
            for number, matrix in strains.items() if name == "root_strains" else ():
                every[lanes[number], :, end - matrix.shape[1] : end] += motion[0][0, :, :-2] @ matrix
        return Sensitivities(
            time=interval * np.arange(valid + 1, dtype=np.float64),
            values=every[0], jacobian=np.moveaxis(every[lanes], 0, 2),
            outputs=sum(labels, ()), parameters=tuple(f"{each} ({UNITS[each.name]})" for each in self.directions),
            status=STATUS[layout.OK if valid + 1 == self.rows.shape[1] else layout.DIVERGED],
            kinks=count_kinks(model, self.rows[0, : valid + 1]),
        )  # fmt: skip


def count_kinks(model: Model, rows: Array) -> dict[str, int]:
    """Return the numbers of intervals between rows (T, 2 d + 2) with a kink, see `Sensitivities.kinks`."""
    constants, n, d, motors = model.constants, model.n_joints, model.n_dof, model.motor_columns
    result = {}
    for i in np.flatnonzero(constants.has_coulomb_friction).tolist():
        result[f"coulomb_friction[{i}]"] = _passages(rows[:, d + motors[i]], np.zeros(1))
    for i in range(n):
        knees = constants.knee_twist[constants.knee_start[i] : constants.knee_start[i + 1]]
        if knees.any():  # a knee at zero, with its mirror image, is none
            knees = knees[knees > 0.0]
            result[f"joint_stiffness[{i}]"] = _passages(rows[:, motors[i]] - rows[:, i], np.append(-knees, knees))
    return result


def _passages(values: Array, levels: Array) -> int:
    """Return the number of steps between successive values (T,) that pass one of several levels."""
    sides = np.sign(values[:, None] - levels)
    return int((sides[1:] * sides[:-1] < 0.0).any(axis=1).sum())


def checked_names(argument: str, given: str | Sequence[str]) -> list[str]:
    """Return names given as one string or several."""
    names = [given] if isinstance(given, str) else [str(each) for each in sequence(argument, given, "names")]
    if not names:
        raise value_error(argument, given, "at least one name")
    return names


def find_directions(text: str, model: Model, prescribed: Sequence[int]) -> list[ScalarParameter]:
    """Return the parameters of a name such as "joint_stiffness" or "joint_stiffness[0]"."""
    name = one_of("to", text.partition("[")[0], UNITS)
    if name in DIMENSIONS:
        return _dimension_parts(text, name, model)
    parameter = PARAMETERS.get(name)
    if parameter and parameter.of == ARM:
        if name != text:
            raise value_error("to", text, name)
        return [ScalarParameter(name, None)]
    lacking = parameter.lacking if parameter else "passive or with prescribed motion"
    count = len(input_columns(model, name)) if name in INPUT_UNITS else model.n_joints
    fixed = parameter.fixed(model) if parameter else np.zeros(count, dtype=bool)
    if name == "motor_torques":
        fixed[list(prescribed)] = True
        fixed |= model.constants.passive > 0
    parts = select_parts("to", text, np.flatnonzero(~fixed).tolist(), count)
    if not parts:
        raise value_error("to", text, f"a parameter that this arm has: {lacking} joints or links")
    return [ScalarParameter(name, part) for part in parts]


def unit_changes(directions: Sequence[ScalarParameter], model: Model) -> tuple[Array, Array]:
    """Return the derivatives of initial row (p, 2 d + 2) and inputs (p, n + 6) with respect to p parameters."""
    rows, inputs = np.zeros((len(directions), 2 * model.n_dof + 2)), np.zeros((len(directions), model.n_joints + 6))
    for number, (name, part) in enumerate(directions):
        if name in INPUT_UNITS:
            inputs[number, input_columns(model, name)[part or 0]] = 1.0
        elif name in INITIAL:
            first = model.n_dof * (name == "initial_joint_rates")
            rows[number, [first + (part or 0), first + model.motor_columns[part or 0]]] = 1.0
    return rows, inputs


def constant_derivatives(
    model: Model, direction: ScalarParameter, given: Mapping[str, Array] | None = None
) -> dict[str, Array]:
    """Return the derivatives of the constants of a model with respect to a parameter, by name.

    They are central differences extrapolated to order six, exact to rounding as the constants are linear or nearly so.

    Args:
        model: the model.
        direction: the parameter.
        given: values of parameters, by name, that replace those of the model.
    """
    name, index = direction
    parameter, given = PARAMETERS[name], given or {}
    nominal = np.array(given.get(name, parameter.nominal(model)), dtype=float)
    place = () if index is None else (index,)
    points, weights = _differences(float(nominal[place]))
    values = np.repeat(nominal[None], len(points), axis=0)
    values[(slice(None), *place)] = points
    others = {each: np.repeat(value[None], len(values), axis=0) for each, value in given.items()
              if PARAMETERS[each].constants is parameter.constants}  # fmt: skip
    changed = parameter.constants(model, others | {name: values})
    return {field: _weigh(weights, each) for field, each in changed.items()}


def motion_output(name: str, model: Model, rows: Array, outputs: Array) -> tuple[Array, tuple[str, ...]]:
    """Return an output of arms and derivatives, and its names with units; all outputs but energies and tip are linear.

    Args:
        name: name of the output.
        model: the model.
        rows: (b, T, 2 d + 2) states and energy ledgers, or their derivatives.
        outputs: (b, T, OUTPUTS) columns of `kernels.layout`, or their derivatives.

    Returns:
        Output (b, T, k) and k names.
    """
    states, n, d = rows[:, :, :-2], model.n_joints, model.n_dof
    if name in ENERGIES:
        return outputs[:, :, ENERGIES[name]].sum(axis=2, keepdims=True), (f"{name} ({OUTPUTS[name]})",)
    if name in TIP_OUTPUTS:
        result = outputs[:, :, TIP_OUTPUTS[name]]
    elif name in ("joint_angles", "joint_rates"):
        first = d * (name == "joint_rates")
        result = states[:, :, first : first + n]
    else:
        result = LinearMeasurements(model).measure(states.reshape(-1, 2 * d))[name].reshape(*rows.shape[:2], -1)
    return result, tuple(column_names(name, OUTPUTS[name], result.shape[2], n))


SPARSE = {"shape": "shape_value", "cross": "cross_value"}  # sparse matrices of the constants whose entries may vanish


@dataclass(frozen=True)
class _Dimension:
    """Dimension or material of a link, or gear ratio of a motor: an entry of DIMENSIONS.

    Attributes:
        unit: unit of the value.
        value: function: link or joint -> value; None if it lacks the parameter.
        changed: function: link or joint and value -> link or joint with this value.
        part: field of the arm, "links" or "joints".
        lacking: reason why parts lack the parameter, for the error message.
    """

    unit: str
    value: Callable[[Any], float | None]
    changed: Callable[[Any, float], Any]
    part: str = "links"
    lacking: str = "more than one section"

    def varied_arm(self, arm: Arm, index: int, value: float) -> Arm:
        """Return an arm with another value of one link or joint."""
        parts: Any = list(getattr(arm, self.part))
        parts[index] = self.changed(parts[index], value)
        changes: dict[str, Any] = {self.part: parts}
        return replace(arm, **changes)


def _uniform(field: str) -> dict[str, Any]:
    """Return value and change of a field of uniform links."""
    return {
        "value": lambda link: getattr(link, field) if isinstance(link, Link) else None,
        "changed": lambda link, value: replace_quietly(link, **{field: value}),
    }


def _longer(link: Link, length: float) -> Link:
    """Return a link of another length, with its lumped masses at the same fractions of the length."""
    masses = [replace(each, position=each.position * (length / link.length)) for each in link.masses]
    return replace_quietly(link, length=length, masses=masses)


def _size(shapes: tuple[str, ...], sides: Callable[[Any], tuple[str, ...]]) -> dict[str, Any]:
    """Return value and change of the size of an outline of given shapes, the field or fields `sides` of the outline."""

    def value(link: Any) -> float | None:
        outline = link.outline if isinstance(link, Link) else None
        return getattr(outline, sides(outline)[0]) if outline and outline.shape in shapes else None

    def changed(link: Link, size: float) -> Link:
        outline: Any = replace(link.outline, **dict.fromkeys(sides(link.outline), size))  # type: ignore[type-var]
        return replace_quietly(link, outline=outline, **outline.sizes)

    return {"value": value, "changed": changed, "lacking": f"no outline of shape {' or '.join(shapes)}"}


def _geared(joint: Any, ratio: float) -> Any:
    """Return a joint whose motor has another gear ratio; motor torques are those at the joint."""
    motor = replace_quietly(joint.motor, gear_ratio=ratio)
    limit = joint.torque_limit if motor.joint_torque_limit is None else None
    return replace_quietly(joint, motor=motor, rotor_inertia=motor.reflected_inertia, torque_limit=limit)


DIMENSIONS = {
    "link_length": _Dimension("m", _uniform("length")["value"], _longer),
    "link_width": _Dimension("m", **_size(("strip",), lambda outline: (OTHER_AXIS[outline.thin_axis],))),
    "link_thickness": _Dimension("m", **_size(("strip",), lambda outline: (outline.thin_axis,))),
    "link_diameter": _Dimension("m", **_size(("tube", "rod"), lambda outline: ("y", "z"))),
    "link_wall": _Dimension("m", **_size(("tube",), lambda outline: ("wall",))),
    "link_youngs_modulus": _Dimension("Pa", **_uniform("youngs_modulus")),
    "link_shear_modulus": _Dimension("Pa", **_uniform("shear_modulus")),
    "link_density": _Dimension("kg/m^3", **_uniform("density")),
    "gear_ratio": _Dimension(
        "1", lambda joint: joint.motor and joint.motor.gear_ratio, _geared, "joints", "no motor"
    ),
}  # fmt: skip
UNITS = INPUTS | {name: row.unit for name, row in DIMENSIONS.items()}


class _DimensionDerivatives(NamedTuple):
    """Constants of a model and their derivatives with respect to dimensions.

    Attributes:
        constants: constants of the model; sparse matrices have entries for all derivatives.
        fields: derivatives by name of the constant, for each direction, empty for a direction that is no dimension.
        strains: derivative (2 d, 3 n) of `model.deformation.root_strain_matrix`, for each dimension, by its number.
    """

    constants: Constants
    fields: list[dict[str, Array]]
    strains: dict[int, Array]


def _dimension_parts(text: str, name: str, model: Model) -> list[ScalarParameter]:
    """Return the dimensions of a text such as "link_length" or "link_length[0]".

    Raises:
        ValueError: for links or joints that lack the dimension.
    """
    dimension, joints = DIMENSIONS[name], model.n_joints
    values = [dimension.value(each) for each in getattr(model.arm, dimension.part)]
    parts = select_parts("to", text, [i for i, value in enumerate(values) if value is not None], joints)
    if not parts:
        raise value_error("to", text, f"a parameter that this arm has: its {dimension.part} have {dimension.lacking}")
    return [ScalarParameter(name, part) for part in parts]


def _dimension_derivatives(model: Model, directions: Sequence[ScalarParameter]) -> _DimensionDerivatives:
    """Return the derivatives of the constants of a model with respect to the dimensions among several directions.

    They are central differences extrapolated to order six, exact to rounding as the constants are smooth functions of
    the relative change of a dimension.
    """
    fields: list[dict[str, Array]] = [{} for _ in directions]
    strains = {}
    for number, (name, index) in enumerate(directions):
        if name in DIMENSIONS and index is not None:
            dimension = DIMENSIONS[name]
            values, weights = _differences(dimension.value(getattr(model.arm, dimension.part)[index]) or 0.0)
            changed = [changed_model(model, dimension.varied_arm(model.arm, index, float(each))) for each in values]
            constants = [_dense(each.constants) for each in changed]
            fields[number] = {field: _weigh(weights, [each[field] for each in constants]) for field in constants[0]}
            strains[number] = _weigh(weights, [root_strain_matrix(each) for each in changed])
    return _DimensionDerivatives(*_with_entries(model.constants, fields, strains), strains)


def _differences(nominal: float) -> tuple[Array, Array]:
    """Return values (6,) of a parameter and the weights of a function of them in its derivative."""
    step = RELATIVE_STEP * abs(nominal) or SMALL_STEP
    both = [(sign * multiple * step, weight) for multiple, weight in RICHARDSON for sign in (1.0, -1.0)]
    changes, weights = np.array(both).T
    return nominal + changes, weights / (2.0 * changes)


def _weigh(weights: Array, values: Any) -> Array:
    """Return the weighted sum of six arrays; differences are taken first, so that what does not change vanishes."""
    values = np.array(values)
    return np.tensordot(weights[::2], values[::2] - values[1::2], axes=1)


def _dense(constants: Constants) -> dict[str, Array]:
    """Return the numbers among constants by name, sparse matrices (rows, k) with all their entries."""
    result = {name: each for name, each in constants._asdict().items() if each.dtype == np.float64}
    for matrix, field in SPARSE.items():
        start, source = getattr(constants, f"{matrix}_start"), getattr(constants, f"{matrix}_source")
        result[field] = np.zeros((len(start) - 1, len(constants.first_moment_shape)))
        result[field][np.repeat(np.arange(len(start) - 1), np.diff(start)), source] = getattr(constants, field)
    return result


def _with_entries(
    constants: Constants, fields: list[dict[str, Array]], dimensions: Any
) -> tuple[Constants, list[dict[str, Array]]]:
    """Return constants and derivatives whose sparse matrices have an entry where any of them is not zero.

    With dimensions, the matrices of all links are coupled; additional entries of the constants are zero.
    """
    if not dimensions:
        return constants, fields
    nominal, changes = _dense(constants), dict[str, Any](coupled=np.ones_like(constants.coupled))
    for matrix, field in SPARSE.items():
        retained = nominal[field] != 0.0
        for number in dimensions:
            retained |= fields[number][field] != 0.0
        changes |= {f"{matrix}_start": np.append(0, np.cumsum(retained.sum(axis=1))), field: nominal[field][retained]}
        changes |= {f"{matrix}_source": np.nonzero(retained)[1].astype(np.int64)}
        for number in dimensions:
            fields[number][field] = fields[number][field][retained]
    return constants._replace(**changes), fields
