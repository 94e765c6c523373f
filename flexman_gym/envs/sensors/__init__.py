"""Sensors of an agent, as names, mappings or objects."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from flexman_gym.common.checks import mapping, one_of, text
from flexman_gym.common.errors import value_error
from flexman_gym.common.registry import Registry
from flexman_gym.envs.sensors.flaws import FLAWS, Flaws
from flexman_gym.envs.sensors.ideal import (
    FineScale,
    FoundationState,
    FullState,
    GoalCommand,
    LastAction,
    ModelState,
    Quantities,
    ServoErrors,
)
from flexman_gym.envs.sensors.instrument import Instrument
from flexman_gym.envs.sensors.sensor import Entry, Sensor
from flexman_gym.model.linearization import LINEAR_SENSORS, LINK_SENSOR

SENSORS: Registry[Callable[[], Sensor]] = Registry(
    "sensor",
    {
        "full": FullState,
        "fine": FineScale,
        "servo": ServoErrors,
        "state": ModelState,
        **{name: partial(Quantities, quantities) for name, quantities in (LINEAR_SENSORS | LINK_SENSOR).items()},
        "accelerometer": lambda: Quantities(("tip_acceleration",)),
        "tip": lambda: Instrument(Quantities(("tip",)), every=2, delay=1),
        "command": GoalCommand,
        "foundation": FoundationState,
        "action": LastAction,
    },
)
"""Named sensors: name -> function that returns a new sensor."""
SENSOR_SETS = {"lab": ("motor_encoders", "joint_encoders", "strain", "command")}
"""Sets of sensors: name -> names in `SENSORS`."""
SENSOR_NAMES = (*SENSORS, *SENSOR_SETS)
"""All names for the setting `sensors` of an environment."""


def find_sensors(value: object) -> tuple[object, ...]:
    """Return the sensors specified by a name, a mapping, a Sensor, or a list of these.

    A mapping has the name of a sensor or of a set at "kind", and flaws, see `Flaws`. The flaws of a set apply to the
    sensors of the set that measure.
    """
    parts = value if isinstance(value, tuple | list) else (value,)
    return tuple(sensor for part in parts for sensor in _find_part(part))


def _find_part(part: object) -> tuple[object, ...]:
    """Return the sensors specified by one name or mapping, or a sensor object itself."""
    if isinstance(part, Mapping):
        if "kind" not in part:
            raise value_error("sensors", dict(part), "a mapping with the name of a sensor at kind, and its flaws")
        flaws = mapping("sensors", {name: value for name, value in part.items() if name != "kind"}, FLAWS)
        kind = text("sensors.kind", part["kind"])
        return tuple(_with_flaws(sensor, flaws, kind in SENSOR_SETS) for sensor in _find_named(kind))
    return _find_named(part) if isinstance(part, str) else (part,)


def _find_named(name: str) -> tuple[Sensor, ...]:
    """Return the sensor of a name, or the sensors of the name of a set."""
    if name not in SENSOR_SETS and name not in SENSORS:
        one_of("sensors", name, (*SENSORS, *SENSOR_SETS))
    return tuple(SENSORS[each]() for each in SENSOR_SETS.get(name, (name,)))


def _with_flaws(sensor: Any, flaws: Mapping[str, Any], in_set: bool) -> Sensor:
    """Return a sensor with flaws, which override flaws of the same names; in a set only sensors that measure."""
    if isinstance(sensor, Instrument):
        return Instrument(sensor.sensor, **{**sensor.settings(), **flaws})
    if not flaws or (in_set and getattr(sensor, "measures", True) == ()):
        return sensor
    return Instrument(sensor, **flaws)


def plain_sensors(parts: tuple[object, ...]) -> list[Any]:
    """Return sensors as JSON-compatible data: names and mappings from which `find_sensors` makes equal sensors.

    Args:
        parts: sensors.

    Raises:
        ValueError: for a sensor of a class defined by the user.
    """
    return [_plain(part) for part in parts]


def _plain(part: object) -> Any:
    """Return the name of a sensor, or its mapping with a name at "kind" and flaws."""
    for name, make in SENSORS.items():
        named: Any = make()
        if named == part:
            return name
        ideal, defaults = (named.sensor, named.flaws) if isinstance(named, Instrument) else (named, Flaws())
        if isinstance(part, Instrument) and ideal == part.sensor:
            flaws = {each: getattr(part.flaws, each) for each in FLAWS}
            return {"kind": name, **{each: value for each, value in flaws.items() if value != getattr(defaults, each)}}
    raise value_error("sensors", part, "a sensor with a name; a file cannot hold an object of the user")


__all__ = [
    "FLAWS",
    "SENSORS",
    "SENSOR_SETS",
    "Entry",
    "FineScale",
    "Flaws",
    "FoundationState",
    "FullState",
    "GoalCommand",
    "Instrument",
    "LastAction",
    "ModelState",
    "Quantities",
    "Sensor",
    "ServoErrors",
]
