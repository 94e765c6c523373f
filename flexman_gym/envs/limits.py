"""Limits of the motion of an arm."""

from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import mapping, positive, set_fields, value_error
from flexman_gym.envs.view import View


@dataclass(frozen=True)
class Limits:
    """Limits of the motion of an arm; an episode terminates when one of them is exceeded.

    Beyond the limits the model is not valid. The limits are compared with the true state, not with measurements.

    Attributes:
        angle: largest magnitude of a motor angle, rad.
        rate: largest magnitude of a motor rate and of the rate of a joint twist, rad/s.
        twist: largest magnitude of a joint twist (elastic deflection of the joint: motor angle minus link-side angle),
            rad.
        deflection: largest deflection of the tip of a link, as a fraction of the length of the link.
        deflection_rate: largest rate of the deflection of the tip of a link, m/s.
        tip_speed: largest speed of the tip along each base axis, m/s.

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

    @classmethod
    def find(cls, value: object) -> Self:
        """Return Limits from a mapping of its arguments; a Limits object is returned unchanged."""
        if isinstance(value, cls):
            return value
        names = [each.name for each in fields(cls)]
        if not isinstance(value, dict):
            raise value_error("limits", value, f"a mapping with some of {', '.join(names)}, or Limits")
        return cls(**mapping("limits", value, names))

    def bounds(self, view: View) -> dict[str, Array]:
        """Return name -> (size,) largest magnitude of each value of a quantity in `view.motion`."""
        sizes = {name: columns.stop - columns.start for name, columns in view.slices.items()}
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
