"""Limits: how far an arm may move before its episode ends."""

from dataclasses import dataclass, fields

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import mapping, positive, set_fields, value_error
from flexman_gym.envs.view import View


@dataclass(frozen=True)
class Limits:
    """How far an arm may move; an episode ends when it goes further. Beyond them the model, too, loses its meaning.

    They belong to the arm: they hold whatever an agent sees.

    Attributes:
        angle: of a motor, rad.
        rate: of a motor, rad/s.
        twist: of a joint spring (motor angle - joint angle), rad; its rate may be `rate`.
        deflection: of a link's tip, as a part of the link's length.
        deflection_rate: of a link's tip, m/s.
        tip_speed: of the tip along each axis, m/s.

    Raises:
        ValueError: for a limit that is not a finite number > 0.
    """

    angle: float = 4.0
    rate: float = 10.0
    twist: float = 1.0
    deflection: float = 0.25
    deflection_rate: float = 15.0
    tip_speed: float = 40.0

    def __post_init__(self) -> None:
        set_fields(self, **{name: positive(f"Limits.{name}", value) for name, value in vars(self).items()})

    def bounds(self, view: View) -> dict[str, Array]:
        """name -> largest magnitude of each entry of that part of `view.motion`."""
        sizes = {name: place.stop - place.start for name, place in view.places.items()}
        values = {
            "motor_angles": self.angle,
            "motor_rates": self.rate,
            "joint_twists": self.twist,
            "joint_twist_rates": self.rate,
            "link_deflections": self.deflection * np.repeat(view.lengths, 2),
            "link_deflection_rates": self.deflection_rate,
            "tip_velocity": self.tip_speed,
        }
        return {name: np.ones(size) * np.asarray(values[name]) for name, size in sizes.items()}


def limit_violation(values: Array, bound: Array, places: dict[str, slice], units: dict[str, str]) -> str:
    """The name of the first of the values (size,) beyond its bound, with value and unit; "" where all are within."""
    inside = np.abs(values) <= bound
    if inside.all():
        return ""
    first = int(np.argmin(inside))
    name = next(name for name, place in places.items() if first < place.stop)
    return f"{name} {values[first]:.4g} {units[name]} beyond {bound[first]:.4g}"


def find_limits(value: object) -> Limits:
    """Gives the Limits of a mapping of their numbers.

    Raises:
        ValueError: for anything else.
    """
    names = [each.name for each in fields(Limits)]
    if not isinstance(value, dict):
        raise value_error("limits", value, f"a mapping with some of {', '.join(names)}, or Limits")
    return Limits(**mapping("limits", value, names))
