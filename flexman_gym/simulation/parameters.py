"""Parameters: the one table of the physical parameters in which the arms of a batch may differ."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from flexman_gym.arrays import Array, Flags
from flexman_gym.checks import MOST, number_array, one_of, refusal
from flexman_gym.model.model import Model

ARM, JOINT, LINK = "arm", "joint", "link"


def _nowhere(model: Model) -> Flags:
    return np.zeros(model.n_joints, dtype=bool)


def _rigid(model: Model) -> Flags:
    return model.constants.motor < 0


def _flexible(model: Model) -> Flags:
    return model.constants.motor >= 0


def _smooth(model: Model) -> Flags:
    return model.constants.rubbing == 0


def _everywhere(model: Model) -> Flags:
    return np.ones(model.n_joints, dtype=bool)


@dataclass(frozen=True)
class Parameter:
    """A row of the table: one physical parameter.

    Attributes:
        unit: of its values.
        of: "arm" for one number, "joint" or "link" for one number of each, (n,).
        nominal: gives the value of a model.
        constants: gives the changed fields of `kernels.layout.Constants`, (r, ...), for the values of r arms. Each must
            be of the type `Own` there.
        factor: whether a randomisation draws factors on the nominal value instead of values.
        fixed: gives (n,) where the value must stay nominal, as the model has no coordinate on which it could act.
        needed: gives (n,) where the value must not be 0.
        lacking: says what such fixed joints are.
    """

    unit: str
    of: str
    nominal: Callable[[Model], Array]
    constants: Callable[[Model, Array], dict[str, Array]]
    factor: bool = False
    fixed: Callable[[Model], Flags] = _nowhere
    needed: Callable[[Model], Flags] = _nowhere
    lacking: str = "rigid"

    def shape(self, joints: int) -> tuple[int, ...]:
        """Gives the shape of the values of one arm."""
        return () if self.of == ARM else (joints,)

    def checked(self, name: str, value: object, model: Model, count: int) -> Array:
        """Gives the values (count, ...) as floats, after checks.

        Args:
            name: of the parameter, for the error.
            value: (count, ...).
            model: the model.
            count: number of arms.

        Raises:
            ValueError: for another shape, for numbers that are not finite or negative, for 0 where more is needed, and
                for another value than the model's where it is fixed.
        """
        shape, nominal = (count, *self.shape(model.n_joints)), self.nominal(model)
        allowed = f"finite numbers >= 0, of shape {shape}"
        values = number_array(name, value, shape, allowed)
        if not ((values >= 0.0) & (values <= MOST)).all():
            raise refusal(name, value, allowed)
        if self.of != ARM:
            fixed, needed = self.fixed(model), self.needed(model)
            if (values != nominal)[:, fixed].any():
                joints = np.flatnonzero(fixed).tolist()
                raise refusal(name, value, f"{nominal[fixed].tolist()} for joints {joints}: {self.lacking}")
            if (values == 0.0)[:, needed].any():
                raise refusal(name, value, "numbers > 0 where a link or joint is flexible")
        return values


def _payload(model: Model, masses: Array) -> dict[str, Array]:
    nominal, mass = model.constants, masses[:, None]
    heavier = mass / nominal.payload_mass[0] if nominal.payload_mass[0] > 0.0 else np.zeros_like(mass)
    return {"payload_mass": mass, "payload_inertia": heavier * nominal.payload_inertia}


def _rotors(model: Model, inertia: Array) -> dict[str, Array]:
    return {"rotor_inertia": inertia, "carried_inertia": inertia * model.choice.spinning_rotors}


def _links(model: Model, factors: Array) -> dict[str, Array]:
    """Scales the stiffness of each link; proportional damping follows it, modal damping keeps its ratio."""
    nominal = model.constants
    factor = np.ones((len(factors), len(nominal.stiffness)))
    factor[:, : nominal.square_start[-1]] = np.repeat(factors, np.diff(nominal.square_start), axis=1)
    stiffness = factor * nominal.stiffness
    damping = model.arm.stiffness_proportional_damping * stiffness + np.sqrt(factor) * model.modal_damping
    return {"stiffness": stiffness, "damping": damping}


PARAMETERS: dict[str, Parameter] = {
    "payload_mass": Parameter("kg", ARM, lambda model: model.constants.payload_mass[0], _payload),
    "joint_stiffness": Parameter(
        "N m/rad", JOINT, lambda model: model.constants.joint_stiffness,
        lambda model, values: {"joint_stiffness": values}, factor=True, fixed=_rigid, needed=_flexible,
    ),
    "joint_damping": Parameter(
        "N m s/rad", JOINT, lambda model: model.constants.joint_damping,
        lambda model, values: {"joint_damping": values}, fixed=_rigid,
    ),
    "rotor_inertia": Parameter(
        "kg m^2", JOINT, lambda model: model.constants.rotor_inertia, _rotors, factor=True, needed=_flexible,
    ),
    "viscous_friction": Parameter(
        "N m s/rad", JOINT, lambda model: model.constants.viscous_friction,
        lambda model, values: {"viscous_friction": values}, factor=True,
    ),
    "coulomb_friction": Parameter(
        "N m", JOINT, lambda model: model.constants.coulomb_friction,
        lambda model, values: {"coulomb_friction": values}, factor=True, fixed=_smooth,
        lacking="without Coulomb friction",
    ),
    "link_stiffness": Parameter(
        "factor on the elastic moduli", LINK, lambda model: np.ones(model.n_joints), _links, factor=True,
        needed=_everywhere,
    ),
}  # fmt: skip


def nominal_parameters(model: Model) -> dict[str, Array]:
    """Gives a copy of the model's value of each parameter, by name."""
    return {name: np.array(parameter.nominal(model)) for name, parameter in PARAMETERS.items()}


def varied_constants(model: Model, count: int, parameters: Mapping[str, object]) -> dict[str, Array]:
    """Gives the constants (count, ...) that change of `count` arms, by the values (count, ...) of their parameters.

    Raises:
        ValueError: as `Batch.vary` does.
    """
    rows = {name: PARAMETERS[one_of("parameters", name, PARAMETERS)] for name in parameters}
    checked = {name: row.checked(name, parameters[name], model, count) for name, row in rows.items()}
    result: dict[str, Array] = {}
    for name, row in rows.items():
        result |= row.constants(model, checked[name])
    return result


def varied_model(model: Model, **parameters: object) -> Model:
    """Gives the model with the same coordinates of an arm with other parameters.

    `build_model` of a changed arm may give other modes, hence other coordinates.

    Args:
        model: the model.
        parameters: value of each, by its name in PARAMETERS, in its unit.

    Raises:
        ValueError: as `Batch.vary` does.
    """
    changed = varied_constants(model, 1, {name: np.asarray(value)[None] for name, value in parameters.items()})
    return replace(model, constants=model.constants._replace(**{name: rows[0] for name, rows in changed.items()}))
