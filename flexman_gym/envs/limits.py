"""Limits of the motion of an arm."""

from dataclasses import dataclass, fields

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import mapping, positive, set_fields, value_error
from flexman_gym.envs.view import View


@dataclass(frozen=True)
class Limits:
    """Limits of the motion of an arm; an episode ends when one of them is exceeded.

    Beyond the limits the model loses its validity. They are checked on the true state, whatever the agent's sensors
    are.

    Attributes:
        angle: of each motor, rad.
        rate: of each motor and of each joint twist, rad/s.
        twist: of each joint, motor angle - joint angle, rad.
        deflection: of the tip of a link, as a fraction of the length of the link.
        deflection_rate: of the tip of a link, m/s.
        tip_speed: of the tip along each base axis, m/s.

    Examples:
        >>> import gymnasium as gym
        >>> env = gym.make("FlexOne-v0", limits=fm.Limits(rate=12.0, tip_speed=10.0))
        >>> env.unwrapped.configuration.limits.rate
        12.0
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
        """Return the largest magnitude of each entry of `view.motion`, by the name of its part."""
        sizes = {name: place.stop - place.start for name, place in view.slices.items()}
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
    """Describe the first value beyond its bound: name, value, unit and bound; "" if all are within.

    Args:
        values: (size,) values.
        bound: (size,) largest magnitudes.
        places: name -> slice of the values.
        units: name -> unit.
    """
    inside = np.abs(values) <= bound
    if inside.all():
        return ""
    first = int(np.argmin(inside))
    name = next(name for name, place in places.items() if first < place.stop)
    return f"{name} {values[first]:.4g} {units[name]} beyond {bound[first]:.4g}"


def find_limits(value: object) -> Limits:
    """Return Limits from a mapping of their values, or a Limits as it is."""
    if isinstance(value, Limits):
        return value
    names = [each.name for each in fields(Limits)]
    if not isinstance(value, dict):
        raise value_error("limits", value, f"a mapping with some of {', '.join(names)}, or Limits")
    return Limits(**mapping("limits", value, names))
