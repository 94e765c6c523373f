"""Free: the numbers of an arm that a fit may change, in logarithms, and how large they may be."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import is_count, one_of, refusal, whole_number
from flexman_gym.model.instant import mass_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.simulation.parameters import ARM, PARAMETERS, nominal_parameters, varied_arm

WIDEST = 7.0  # largest departure of a logarithm from its start: a factor of 1100
CRITICAL = 0.99  # largest damping ratio of a link
STEP = 1e-3  # of a logarithm, to either side, over which responses are differentiated
SLOW = 2.0 * np.pi  # rad/s, of the usual sizes below
USUAL: dict[str, Callable[[Model, Array], Array | float]] = {  # where the arm says 0, a size to start from
    "payload_mass": lambda model, inertia: 0.1 * sum(link.mass for link in model.arm.links),
    "joint_damping": lambda model, inertia: 0.02 * np.sqrt(model.constants.joint_stiffness * inertia),
    "rotor_inertia": lambda model, inertia: 0.1 * inertia,
    "viscous_friction": lambda model, inertia: 0.02 * SLOW * inertia,
    "coulomb_friction": lambda model, inertia: 0.01 * SLOW**2 * inertia,
    "link_damping": lambda model, inertia: np.full(model.n_joints, 0.01),
}


class Number(NamedTuple):
    """A number that is free: a parameter in PARAMETERS, and of which joint or link, from 0; None of the arm."""

    parameter: str
    place: int | None

    def __str__(self) -> str:
        return self.parameter if self.place is None else f"{self.parameter}[{self.place}]"


class Free:
    """What of an arm is free.

    Attributes:
        asked: the names as they were given, name -> its Numbers.
        numbers: all of them, p.
        arm: that the fit starts from; where it had 0 in place of a free number, it has one of a usual size.
        start: (p,) their values there.
        highest: (p,) by how much their logarithms may grow.
    """

    def __init__(self, arm: Arm, free: str | Sequence[str]) -> None:
        names = [free] if isinstance(free, str) else list(free)
        if not names:
            raise refusal("free", free, f"at least one of {', '.join(PARAMETERS)}")
        model = build_model(arm, 1, flexible_links=False)
        self.asked = {str(name): _numbers(str(name), model) for name in names}
        self.numbers = list(dict.fromkeys(number for some in self.asked.values() for number in some))
        self.arm, self._base = arm, nominal_parameters(model)
        inertia = np.diag(mass_matrix(model, np.zeros(2 * model.n_dof)))[: model.n_joints]
        start = self.of(self._base)
        for i in np.flatnonzero(start == 0.0):
            number = self.numbers[i]
            usual = np.ravel(USUAL[number.parameter](model, inertia))
            start[i] = usual[number.place or 0]
        self.start, self.arm = start, self.changed(start)
        ratios = np.array([number.parameter == "link_damping" for number in self.numbers])
        self.highest = np.where(ratios, np.log(CRITICAL / start), WIDEST)

    def of(self, parameters: Mapping[str, Any]) -> Array:
        """Gives the free numbers (p,) of parameters by name."""
        return np.array([np.ravel(parameters[each.parameter])[each.place or 0] for each in self.numbers], dtype=float)

    def parameters(self, values: Array, rest: float = 1.0) -> dict[str, Array]:
        """Gives parameters of the starting arm by name, `rest` times what they are, but for the free numbers (p,)."""
        result = {each.parameter: rest * np.array(self._base[each.parameter], ndmin=1) for each in self.numbers}
        for number, value in zip(self.numbers, values, strict=True):
            result[number.parameter][number.place or 0] = value
        return {name: each if PARAMETERS[name].of != ARM else each[0] for name, each in result.items()}

    def changed(self, values: Array) -> Arm:
        """Gives the arm with free numbers (p,)."""
        return varied_arm(self.arm, self.parameters(values))

    def lanes(self, model: Model, departures: Array) -> dict[str, Array]:
        """Gives parameters (1 + 2 p, ...) of arms beside a model's.

        Args:
            model: of an arm.
            departures: (p,) of the logarithms from those of this arm, of all; each number is once larger by STEP, and
                once smaller.
        """
        count, nominal = 1 + 2 * len(self.numbers), nominal_parameters(model)
        result = {each.parameter: np.array([nominal[each.parameter]] * count) for each in self.numbers}
        for i, number in enumerate(self.numbers):
            own = np.full(count, departures[i])
            own[1 + 2 * i : 3 + 2 * i] += STEP, -STEP
            result[number.parameter][(slice(None), *(() if number.place is None else (number.place,)))] *= np.exp(own)
        return result


def _numbers(name: str, model: Model) -> list[Number]:
    """The numbers of a name, such as joint_stiffness or joint_stiffness[1]."""
    kind, _, place = name.partition("[")
    if PARAMETERS[one_of("free", kind, PARAMETERS)].of == ARM:
        if place:
            raise refusal("free", name, kind)
        return [Number(kind, None)]
    sprung = kind in ("joint_stiffness", "joint_damping")
    there = np.flatnonzero(model.constants.motor >= 0).tolist() if sprung else list(range(model.n_joints))
    if place:
        if not (place.endswith("]") and is_count(place[:-1])):
            raise refusal("free", name, f"{kind}, or {kind}[0] and so on")
        there = [each for each in there if each == whole_number("free", int(place[:-1]), 0, model.n_joints - 1)]
    if not there:
        raise refusal("free", name, "a parameter that this arm has: the joint is rigid")
    return [Number(kind, each) for each in there]
