"""Sensors: what an agent sees of the arms, by name or as objects of one's own."""

from flexman_gym.checks import one_of
from flexman_gym.envs.sensors.fine import Fine
from flexman_gym.envs.sensors.full import FullState
from flexman_gym.envs.sensors.sensor import Entry, Sensor, Sensors
from flexman_gym.envs.sensors.servo import Servo
from flexman_gym.envs.sensors.state import State

SENSORS: dict[str, type[Sensor]] = {"full": FullState, "fine": Fine, "servo": Servo, "state": State}


def find_sensors(value: object) -> tuple[object, ...]:
    """The sensors that a name, a sensor, or several of either mean; raises ValueError for an unknown name."""
    parts = value if isinstance(value, tuple | list) else (value,)
    return tuple(SENSORS[one_of("sensors", part, SENSORS)]() if isinstance(part, str) else part for part in parts)


__all__ = ["SENSORS", "Entry", "Fine", "FullState", "Sensor", "Sensors", "Servo", "State", "find_sensors"]
