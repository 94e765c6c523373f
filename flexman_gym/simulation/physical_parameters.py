"""Physical parameters in which the arms of a batch may differ: table, checks, and their model constants."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray
from flexman_gym.common.checks import MAX_SIZE, is_decimal_integer, number_array, one_of, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.model.joint_constants import spring_knees
from flexman_gym.model.model import Model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import replace_quietly
from flexman_gym.scene.link import NonUniformLink
from flexman_gym.scene.rigid_body import Payload

ARM, JOINT, LINK = "arm", "joint", "link"


# Reason why the value of a joint or link must stay nominal -> function: model -> flags (n,) of these joints or links.
LACKING: dict[str, Callable[[Model], BoolArray]] = {
    "": lambda model: np.zeros(model.n_joints, dtype=bool),
    "rigid": lambda model: model.constants.motor < 0,
    "without Coulomb friction": lambda model: model.constants.has_coulomb_friction == 0,
    "without backlash": lambda model: (
        np.array([joint.backlash is None for joint in model.arm.joints]) | (model.constants.motor < 0)
    ),
    "without stiffness pieces": lambda model: np.diff(model.constants.knee_start) <= 1,
    "without torque ripple": lambda model: model.constants.has_ripple == 0,
    "of links without modal damping": lambda model: np.array(model.arm.damping_ratios) == 0.0,
}


@dataclass(frozen=True)
class _Parameter:
    """Physical parameter: an entry of PARAMETERS.

    Attributes:
        unit: unit of the values.
        of: part with one value: "arm" for one number, "joint" or "link" for one number per joint or link, (n,).
        nominal: function: model -> value in the model.
        constants: function: model and values of all given parameters of r arms, by name -> changed fields (r, ...) of
            `kernels.layout.Constants`, all of them in `kernels.arguments.PER_ARM`.
        factor: True if a randomisation draws factors on the nominal value instead of values.
        lacking: reason, in LACKING, why the values of some joints or links must stay nominal; "" if none must.
        positive_unless: reason, in LACKING, without which the value of a joint or link must be positive; None allows 0.
    """

    unit: str
    of: str
    nominal: Callable[[Model], Array]
    constants: Callable[[Model, Mapping[str, Array]], dict[str, Array]]
    factor: bool = False
    lacking: str = ""
    positive_unless: str | None = None

    @property
    def may_be_zero(self) -> bool:
        """True if a value of 0 is allowed in every model."""
        return self.positive_unless is None

    def fixed(self, model: Model) -> BoolArray:
        """Return flags (n,) of the joints or links whose value must stay nominal."""
        return LACKING[self.lacking](model)

    def shape(self, joints: int) -> tuple[int, ...]:
        """Return the shape of the values of one arm."""
        return () if self.of == ARM else (joints,)

    def checked(self, name: str, value: object, model: Model, count: int) -> Array:
        """Check the values of a parameter for several arms and return them as floats.

        Args:
            name: name of the parameter, for the error.
            value: values (count,) or (count, n).
            model: the model.
            count: number of arms.

        Raises:
            ValueError: for a wrong shape, for negative or non-finite numbers, for 0 where a positive value is needed,
                and for a changed value where it is fixed.
        """
        shape, nominal = (count, *self.shape(model.n_joints)), self.nominal(model)
        allowed = f"finite numbers >= 0, of shape {shape}"
        values = number_array(name, value, shape, allowed)
        if not ((values >= 0.0) & (values <= MAX_SIZE)).all():
            raise value_error(name, value, allowed)
        if self.of != ARM:
            fixed = self.fixed(model)
            if (values != nominal)[:, fixed].any():
                joints = np.flatnonzero(fixed).tolist()
                raise value_error(name, value, f"{nominal[fixed].tolist()} for joints {joints}: {self.lacking}")
            needed = np.zeros_like(fixed) if self.positive_unless is None else ~LACKING[self.positive_unless](model)
            if (values == 0.0)[:, needed].any():
                raise value_error(name, value, f"numbers > 0 for joints or links {np.flatnonzero(needed).tolist()}")
        return values


def _payload_constants(model: Model, given: Mapping[str, Array]) -> dict[str, Array]:
    nominal, mass = model.constants, given["payload_mass"][:, None]
    ratio = mass / nominal.payload_mass[0] if nominal.payload_mass[0] > 0.0 else np.zeros_like(mass)
    return {"payload_mass": mass, "payload_inertia": ratio * nominal.payload_inertia}


def _rotor_constants(model: Model, given: Mapping[str, Array]) -> dict[str, Array]:
    inertia = given["rotor_inertia"]
    return {"rotor_inertia": inertia, "carried_inertia": inertia * model.choice.spinning_rotors}


def _joint_constant(name: str, unit: str, constant: str = "", **more: Any) -> _Parameter:
    """Return the parameter of joints that is a constant, by default that of the same name."""
    constant = constant or name
    nominal, constants = lambda model: getattr(model.constants, constant), lambda model, given: {constant: given[name]}
    return _Parameter(unit, JOINT, nominal, constants, **more)


def _first_knees(model: Model, values: Array, without: float) -> Array:
    """Return the value (n,) at the first knee of each joint spring, and `without` for springs without knees."""
    result, bent = np.full(model.n_joints, without), np.diff(model.constants.knee_start) > 0
    result[bent] = values[model.constants.knee_start[:-1][bent]]
    return result


def _backlash(model: Model) -> Array:
    return 2.0 * _first_knees(model, model.constants.knee_twist, 0.0)


def _soft_stiffness(model: Model) -> Array:
    return _first_knees(model, model.constants.knee_share, 1.0)


def _spring_constants(model: Model, given: Mapping[str, Array]) -> dict[str, Array]:
    """Return joint stiffness and knees; the torques at which stiffness pieces end do not change."""
    nominal = {"joint_stiffness": model.constants.joint_stiffness, "backlash": _backlash(model)}
    nominal["soft_stiffness"] = _soft_stiffness(model)
    count = len(next(iter(given.values())))
    values = [given.get(name, np.tile(value, (count, 1))) for name, value in nominal.items()]
    bent = np.flatnonzero(np.diff(model.constants.knee_start))
    twists, shares = spring_knees(model.arm, bent.tolist(), *values)
    return {"joint_stiffness": values[0]} | ({"knee_twist": twists, "knee_share": shares} if bent.size else {})


def _link_constants(model: Model, given: Mapping[str, Array]) -> dict[str, Array]:
    """Return the stiffness and damping matrices of the links for given stiffness factors and modal damping ratios.

    Stiffness-proportional damping scales with the stiffness. Modal damping scales with its square root, so that modal
    damping ratios do not change with the stiffness.
    """
    nominal = model.constants
    factor = (
        _expand_to_blocks(model, given["link_stiffness_factor"])
        if "link_stiffness_factor" in given
        else np.ones((1, 1))
    )
    stiffness, modal = factor * nominal.stiffness, np.sqrt(factor) * model.modal_damping
    if "link_damping" in given:
        ratios = np.array(model.arm.damping_ratios)
        modal = modal * _expand_to_blocks(model, given["link_damping"] / np.where(ratios > 0.0, ratios, 1.0))
    damping = model.arm.stiffness_proportional_damping * stiffness + modal
    return {"stiffness": stiffness, "damping": damping} if "link_stiffness_factor" in given else {"damping": damping}


def _expand_to_blocks(model: Model, factors: Array) -> Array:
    """Return factors (r, n) of links as factors (r, q + LANES) of `Constants.stiffness`, padded by LANES entries."""
    result = np.ones((len(factors), len(model.constants.stiffness)))
    result[:, : model.constants.square_start[-1]] = np.repeat(factors, np.diff(model.constants.square_start), axis=1)
    return result


PARAMETERS: dict[str, _Parameter] = {
    "payload_mass": _Parameter("kg", ARM, lambda model: model.constants.payload_mass[0], _payload_constants),
    "joint_stiffness": _Parameter(
        "N m/rad", JOINT, lambda model: model.constants.joint_stiffness, _spring_constants,
        factor=True, lacking="rigid", positive_unless="rigid",
    ),
    "joint_damping": _joint_constant("joint_damping", "N m s/rad", lacking="rigid"),
    "rotor_inertia": _Parameter(
        "kg m^2", JOINT, lambda model: model.constants.rotor_inertia, _rotor_constants, factor=True,
        positive_unless="rigid",
    ),
    "viscous_friction": _joint_constant("viscous_friction", "N m s/rad", "rotor_damping", factor=True),
    "coulomb_friction": _joint_constant(
        "coulomb_friction", "N m", factor=True, lacking="without Coulomb friction",
    ),
    "coulomb_rate": _joint_constant(
        "coulomb_rate", "rad/s", lacking="without Coulomb friction", positive_unless="without Coulomb friction",
    ),
    "static_excess": _joint_constant(
        "static_excess", "1, static friction / Coulomb friction - 1", lacking="without Coulomb friction",
    ),
    "stribeck_rate": _joint_constant(
        "stribeck_rate", "rad/s", lacking="without Coulomb friction", positive_unless="without Coulomb friction",
    ),
    "backlash": _Parameter("rad", JOINT, _backlash, _spring_constants, lacking="without backlash"),
    "soft_stiffness": _Parameter(
        "1, stiffness at small torques / joint_stiffness", JOINT, _soft_stiffness, _spring_constants,
        lacking="without stiffness pieces", positive_unless="without stiffness pieces",
    ),
    "ripple_torque": _joint_constant("ripple_torque", "N m", lacking="without torque ripple"),
    "link_stiffness_factor": _Parameter(
        "1, factor on the elastic moduli", LINK, lambda model: np.ones(model.n_joints), _link_constants, factor=True,
        positive_unless="",
    ),
    "link_damping": _Parameter(
        "damping ratio of every mode", LINK, lambda model: np.array(model.arm.damping_ratios), _link_constants,
        factor=True, lacking="of links without modal damping",
    ),
}  # fmt: skip


UNMODELLED = frozenset(
    ("coulomb_rate", "static_excess", "stribeck_rate", "backlash", "soft_stiffness", "ripple_torque")
)
"""Parameters whose drawn values and ranges are given to no controller: shape of friction, knees of springs, ripple."""
UNCERTAIN = {f"{name.removesuffix('_factor')}_factor" if row.factor else name: name for name, row in PARAMETERS.items()}
"""Name of a range of an uncertain parameter -> parameter; NAME_factor is a range of factors on the nominal value."""


class ScalarParameter(NamedTuple):
    """One number of a parameter: its name, and the index of its joint, link or axis, None for one of the arm."""

    name: str
    part: int | None

    def __str__(self) -> str:
        return self.name if self.part is None else f"{self.name}[{self.part}]"


def select_parts(argument: str, text: str, parts: Sequence[int], count: int) -> list[int]:
    """Return the indices that a text such as "joint_stiffness" or "joint_stiffness[0]" selects.

    Args:
        argument: name of the argument with the text, for the error.
        text: name of a parameter, for all parts, or with the index of one part.
        parts: indices of the parts with this parameter.
        count: number of joints, links or axes.

    Returns:
        All parts, the part with the index, or none if it lacks the parameter.

    Raises:
        ValueError: for an index that is no whole number from 0 to count - 1.
    """
    name, bracket, index = text.partition("[")
    if not bracket:
        return list(parts)
    if not (index.endswith("]") and is_decimal_integer(index[:-1])):
        raise value_error(argument, text, f"{name}, or {name}[0] and so on")
    part = whole_number(argument, int(index[:-1]), 0, count - 1)
    return [part] if part in parts else []


def nominal_parameters(model: Model) -> dict[str, Array]:
    """Return the value in the model of each parameter in PARAMETERS, by name."""
    return {name: np.array(parameter.nominal(model)) for name, parameter in PARAMETERS.items()}


def varied_constants(model: Model, count: int, parameters: Mapping[str, object]) -> dict[str, Array]:
    """Return the fields (count, ...) of `kernels.layout.Constants` changed by values of physical parameters, by name.

    Args:
        model: the model.
        count: number of arms.
        parameters: values (count,) or (count, n) by their name in PARAMETERS.

    Raises:
        ValueError: as `Batch.vary`.
    """
    rows = {name: PARAMETERS[one_of("parameters", name, PARAMETERS)] for name in parameters}
    checked = {name: row.checked(name, parameters[name], model, count) for name, row in rows.items()}
    result: dict[str, Array] = {}
    for row in rows.values():
        result |= row.constants(model, checked)
    return result


def varied_model(model: Model, **parameters: object) -> Model:
    """Return the model of an arm with changed parameters, in the coordinates of the given model.

    The component modes of the given model are kept, whereas `build_model` computes the modes of the changed arm.

    Args:
        model: the model.
        **parameters: values by their name in PARAMETERS, in the units there.

    Raises:
        ValueError: as `Batch.vary`.
    """
    changed = varied_constants(model, 1, {name: np.asarray(value)[None] for name, value in parameters.items()})
    return replace(model, constants=model.constants._replace(**{name: rows[0] for name, rows in changed.items()}))


def varied_arm(arm: Arm, values: Mapping[str, Array]) -> Arm:
    """Return an arm with changed physical parameters; the gear ratios of motors do not change.

    Args:
        arm: the arm.
        values: values by their name in PARAMETERS, as in `varied_model`; stiffness and damping of rigid joints are
            ignored.
    """
    links = arm.links
    if "link_stiffness_factor" in values:
        factors = values["link_stiffness_factor"]
        links = [_scale_moduli(link, float(each)) for link, each in zip(links, factors, strict=True)]
    joints = [_varied_joint(joint, values, i) for i, joint in enumerate(arm.joints)]
    payload: Any = arm.payload
    if "payload_mass" in values:
        mass, load = float(values["payload_mass"]), arm.payload or Payload(0.0)
        inertia = None if load.inertia is None else np.array(load.inertia) * (mass / load.mass)
        payload = Payload(mass, inertia if mass else None, load.offset if mass else None)
    ratios = values.get("link_damping", arm.modal_damping_ratio)
    return replace(arm, links=links, joints=joints, payload=payload, modal_damping_ratio=ratios)


def _varied_joint(joint: Any, values: Mapping[str, Array], i: int) -> Any:
    """Return a joint with its values, at index i, of the given parameters."""
    own = {name: name for name in ("viscous_friction", "coulomb_friction", "coulomb_rate", "stribeck_rate")}
    own |= {"rotor_inertia": "rotor_inertia"}
    if joint.stiffness is not None and not joint.passive:  # the spring of a passive joint is no parameter
        own |= {"stiffness": "joint_stiffness", "damping": "joint_damping"}
        own |= {"backlash": "backlash"} if joint.backlash is not None else {}
    changes: dict[str, Any] = {field: float(values[name][i]) for field, name in own.items() if name in values}
    if "viscous_friction" in changes:
        changes["viscous_friction"] -= joint.rotor_damping - joint.viscous_friction
    if joint.stiffness_pieces and "soft_stiffness" in values:
        (torque, _), *rest = joint.stiffness_pieces
        changes["stiffness_pieces"] = ((torque, float(values["soft_stiffness"][i])), *rest)
    coulomb = changes.get("coulomb_friction", joint.coulomb_friction)
    if coulomb > 0.0 and not {"coulomb_friction", "static_excess"}.isdisjoint(values):
        excess = float(values["static_excess"][i]) if "static_excess" in values else joint.static_excess
        changes["static_friction"] = coulomb * (1.0 + excess) if excess else None
    if joint.motor is not None:
        changes |= _varied_motor(joint.motor, changes, values, i)
    return replace(joint, **changes)


def _varied_motor(motor: Any, changes: dict[str, Any], values: Mapping[str, Array], i: int) -> dict[str, Any]:
    """Return the fields `motor` and `rotor_inertia` of a joint with its values, at index i, of the given parameters."""
    own: dict[str, float] = {}
    if "rotor_inertia" in changes:
        own["rotor_inertia"] = changes["rotor_inertia"] / motor.gear_ratio**2
    if motor.ripple_cycles is not None and "ripple_torque" in values:
        own["torque_ripple"] = float(values["ripple_torque"][i]) / (motor.gear_ratio * motor.efficiency)
    motor = replace(motor, **own)
    return {"motor": motor, "rotor_inertia": motor.reflected_inertia}


def _scale_moduli(link: Any, factor: float) -> Any:
    """Return a link with its elastic moduli scaled by a factor."""
    if isinstance(link, NonUniformLink):
        return replace(link, sections=[_scale_moduli(section, factor) for section in link.sections])
    moduli = {name: factor * getattr(link, name) for name in ("youngs_modulus", "shear_modulus")}
    return replace_quietly(link, **moduli)
