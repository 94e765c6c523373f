"""Settings of an environment: declaration, checks and plain form of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from flexman_gym.common.checks import physical, positive, sequence, text, value_error
from flexman_gym.control.actions import ActionMode, parse_action_mode
from flexman_gym.control.base_controllers import BASES, parse_base
from flexman_gym.control.controller import checked_controller
from flexman_gym.envs.limits import Limits, find_limits
from flexman_gym.envs.tasks import Task, check_task, find_task
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import warn_unusual_units

MIN_PERIOD, MAX_PERIOD = 1e-9, 100.0  # s; control period


@dataclass(frozen=True)
class Setting:
    """Declaration of one setting.

    Attributes:
        help: meaning; the first sentence stands in tables.
        check: function of the value; returns the stored value or raises a ValueError of one line.
        default: value of a setting that is not given; None in place of one that the named environment has.
        unit: SI unit; "" for none.
        named: whether the named environment has a value for None.
        plain: plain form of a stored object; None where the stored value is plain.
        formerly: deprecated names.
        elsewhere: name in other libraries -> what to give in its place.
    """

    help: str
    check: Callable[[Any], Any]
    default: Any = None
    unit: str = ""
    named: bool = False
    plain: Callable[[Any], Any] | None = None
    formerly: tuple[str, ...] = ()
    elsewhere: Mapping[str, str] = field(default_factory=dict)


def is_plain(value: object) -> bool:
    """Return whether a value consists of texts, numbers, booleans, None, lists and mappings."""
    if isinstance(value, dict):
        return all(map(is_plain, value.values()))
    if isinstance(value, list | tuple):
        return all(map(is_plain, value))
    return value is None or isinstance(value, bool | int | float | str)


def checked_task(value: object) -> Task:
    """Return a task, or that of a name or a mapping."""
    result = find_task(value) if is_plain(value) else value
    if not isinstance(result, Task) or isinstance(result, type):
        allowed = "a task: an object with sensors, moves, draw, goal, reward_terms and info, such as Slew()"
        raise value_error("task", value, allowed)
    check_task(result)
    return result


def checked_limits(value: object) -> Limits:
    """Return Limits, or those of a mapping."""
    result = find_limits(value) if is_plain(value) else value
    if not isinstance(result, Limits):
        raise value_error("limits", value, "Limits")
    return result


def checked_period(value: object) -> float:
    """Return a control period, s."""
    period = positive("control_period", value, "s")
    if not MIN_PERIOD <= period <= MAX_PERIOD:
        raise value_error("control_period", value, f"a number from {MIN_PERIOD:g} to {MAX_PERIOD:g} (s)")
    warn_unusual_units("", {"control_period": period})
    return period


def checked_base_setting(value: Any) -> Any:
    """Return None, a name or a mapping of BASES as it is, or a Controller that takes the number of arms."""
    if isinstance(value, str | dict):
        parse_base(value)
    elif value is not None:
        return checked_controller("base", value, f"None, one of {', '.join(BASES)}, or ")
    return value


def checked_actions(value: Any) -> Any:
    """Return the name or the mapping of an action mode, or an ActionMode, as it is."""
    if not isinstance(value, ActionMode):
        parse_action_mode(value)
    return value


def checked_bandwidth(value: object) -> float | None:
    """Return a bandwidth, Hz, or None."""
    return None if value is None else physical("drive_bandwidth", value, "Hz")


def checked_names(value: object) -> tuple[str, ...]:
    """Return the names of quantities of a view."""
    return tuple(text(f"tell[{i}]", each) for i, each in enumerate(sequence("tell", value, "names")))


def tuples(value: Any) -> Any:
    """Return lists as tuples, all the way down."""
    return tuple(map(tuples, value)) if isinstance(value, list) else value


def lists(value: Any) -> Any:
    """Return tuples as lists, all the way down."""
    if isinstance(value, dict):
        return {name: lists(each) for name, each in value.items()}
    return [lists(each) for each in value] if isinstance(value, list | tuple) else value


def put(data: dict[str, Any], path: list[str], value: object) -> None:
    """Write a value into a mapping of mappings; anything else on the path becomes a mapping."""
    for part in path[:-1]:
        inner = data.get(part)
        data[part] = data = dict(inner) if isinstance(inner, dict) else {}
    data[path[-1]] = value


def links_and_motors(arm: Arm) -> tuple[object, ...]:
    """Return the parts of an arm for which gains of a PD are tuned."""
    return arm.links, [(joint.axis, joint.rotor_inertia, joint.stiffness) for joint in arm.joints]


def keep(value: Any) -> Any:
    """Return a value as it is; its check depends on other settings."""
    return value
