"""Base controllers by name: table of their entries, and construction from names and mappings."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import getdoc, signature
from typing import Any, Protocol

from flexman_gym.agent.controller import Controller, Plant
from flexman_gym.common.checks import mapping, one_of, text
from flexman_gym.common.errors import value_error
from flexman_gym.common.registry import Registry


class _Entry(Protocol):
    """Entry of a table of base controllers or action modes: `arguments` are the names of its arguments."""

    @property
    def arguments(self) -> tuple[str, ...]: ...


def parse_kind(field: str, value: object, table: Mapping[str, _Entry]) -> tuple[str, dict[str, Any]]:
    """Return name and arguments of a base controller or an action mode.

    Args:
        field: name of the field, for error messages.
        value: name, or mapping with the name under "kind" and the arguments.
        table: `BASES` or `ACTIONS`.
    """
    if isinstance(value, str):
        return one_of(field, value, table), {}
    if not isinstance(value, Mapping) or "kind" not in value:
        raise value_error(field, value, "a name, or a mapping with the name under kind and its arguments")
    name = one_of(f"{field}.kind", text(f"{field}.kind", value["kind"]), table)
    given = {text(f"a key of {field}", key): each for key, each in value.items() if key != "kind"}
    return name, mapping(field, given, table[name].arguments)


PASSIVE = ("none", "some", "all")  # joints of an arm that lack a motor
PASSIVE_ARMS = {"some": "with passive joints", "all": "without motors"}
DEFAULT_TUNING = "none: default weights for every arm"  # tuning of controllers designed from a model


@dataclass(frozen=True)
class ControllerEntry:
    """Entry of a controller in the table of base controllers, which stands in the file of the controller.

    Attributes:
        make: function of a Plant and the arguments that returns the controller.
        information: information beyond motor measurements that the controller requires.
        arguments: names of the arguments that a mapping may contain.
        description: noun phrase for the league page.
        tuning: origin of the gains.
        passive: joints that may lack a motor, of PASSIVE: "all" for a controller of a foundation that travels.
    """

    make: Callable[..., Controller]
    information: tuple[str, ...]
    arguments: tuple[str, ...]
    description: str
    tuning: str = DEFAULT_TUNING
    passive: str = PASSIVE[0]


_PLACE = "flexman_gym.toolbox.controllers"


def _as_entry(name: str, found: Any) -> ControllerEntry:
    """Return the entry of a plug-in, which is a `ControllerEntry` or a function of a plant and keyword arguments."""
    if isinstance(found, ControllerEntry):
        return found
    if not callable(found):
        raise value_error(f"controller {name}", found, "a ControllerEntry, or a function of a Plant")
    _, *arguments = signature(found).parameters
    description = (getdoc(found) or f"controller {name}").splitlines()[0].rstrip(".")
    return ControllerEntry(found, (), tuple(arguments), description, "not known")


BASES: Registry[ControllerEntry] = Registry("controller", {
    "pd": "flexman_gym.agent.pd:ENTRY",
    "pd-torque": f"{_PLACE}.torque_feedback_pd:ENTRY",
    "lqr": f"{_PLACE}.lqr:LQR_ENTRY",
    "lqr-tracking": f"{_PLACE}.lqr:TRACKING_ENTRY",
    "lqg": f"{_PLACE}.output_feedback:LQG_ENTRY",
    "hinf": f"{_PLACE}.hinf:ENTRY",
    "mpc": f"{_PLACE}.mpc:ENTRY",
    "optimised": f"{_PLACE}.references.optimised_slews:ENTRY",
    "planned": f"{_PLACE}.references.planned_slews:ENTRY",
    "adaptive-lqr": f"{_PLACE}.output_feedback:ADAPTIVE_ENTRY",
    "adaptive-planned": f"{_PLACE}.output_feedback:ADAPTIVE_PLANNED_ENTRY",
    "privileged-lqr": f"{_PLACE}.output_feedback:PRIVILEGED_ENTRY",
    "privileged-planned": f"{_PLACE}.output_feedback:PRIVILEGED_PLANNED_ENTRY",
    "pd-shaped": f"{_PLACE}.input_shaping.shaped_controller:ENTRY",
}, _as_entry)  # fmt: skip
"""Base controllers: name -> construction, required information, arguments and description."""


def make_base(value: object, plant: Plant) -> Controller:
    """Make a base controller, given by name or mapping, for a plant; see `parse_kind`."""
    name, arguments = parse_kind("base", value, BASES)
    passive = plant.model.constants.passive
    served = PASSIVE[int(passive.any()) + int(passive.all()) :]
    if BASES[name].passive not in served:
        arm, possible = PASSIVE_ARMS[served[0]], ", ".join(each for each in BASES if BASES[each].passive in served)
        raise value_error("base", name, f"{possible}, or a controller of your own, for an arm {arm}")
    return BASES[name].make(plant, **arguments)
