"""Derivatives of the constants of a model with respect to dimensions and materials of links, and gear ratios.

A dimension changes constants that all arms of a batch share. The node coordinates of a link per unit of each elastic
coordinate do not change with it: the shapes of component modes are held. Without modes, the elastic coordinates are the
node coordinates themselves, and the derivative is that of the complete finite-element model.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import value_error
from flexman_gym.kernels.layout import Constants
from flexman_gym.model.deformation import root_strain_matrix
from flexman_gym.model.dynamics import RICHARDSON
from flexman_gym.model.model import Model, changed_model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import replace_quietly
from flexman_gym.scene.link import OTHER_AXIS, Link
from flexman_gym.simulation.parameters import ScalarParameter, select_parts

RELATIVE_STEP = 1e-2  # relative step of the differences of constants
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


def dimension_parts(text: str, model: Model) -> list[ScalarParameter]:
    """Return the dimensions of a name such as "link_length" or "link_length[0]"; none if it names no dimension.

    Raises:
        ValueError: for links or joints that lack the dimension.
    """
    name = text.partition("[")[0]
    if name not in DIMENSIONS:
        return []
    dimension, joints = DIMENSIONS[name], model.n_joints
    values = [dimension.value(each) for each in getattr(model.arm, dimension.part)]
    parts = select_parts("to", text, [i for i, value in enumerate(values) if value is not None], joints)
    if not parts:
        raise value_error("to", text, f"a parameter that this arm has: its {dimension.part} have {dimension.lacking}")
    return [ScalarParameter(name, part) for part in parts]


def dimension_derivatives(model: Model, directions: Sequence[ScalarParameter]) -> _DimensionDerivatives:
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
    step = RELATIVE_STEP * nominal
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
