"""Fine: the quantities of the full state again, on a scale that tells millimetres and milliradians."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.simulation.view import View

# What counts as small: parts of the limits of motors and joints, parts of the reach (and reaches a second) of the rest.
ANGLE, RATE, TWIST, DEFLECTION, LENGTH, SPEED = 1 / 400, 1 / 500, 1 / 250, 1 / 2125, 1 / 425, 1 / 170


@dataclass
class Fine:
    """arcsinh(quantity / scale): linear below the scale, logarithmic above, so that a network sees both ends.

    For n joints: motor rates, joint twists and their rates, deflections of the links and their rates, angle errors,
    the error of the tip and the velocity of the tip. For `FlexRRR-v0` the scales are 0.02 rad/s, 0.004 rad, 0.02 rad/s,
    0.004 m, 0.02 m/s, 0.01 rad, 0.02 m and 0.05 m/s; others follow from the limits and the reach of the arm.
    """

    measures: ClassVar[tuple[str, ...]] = ("motion", "tip")

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Says what it reads, in order."""
        bounds = limits.bounds(view)
        largest = {
            **{name: bounds[name] for name in view.places if name not in ("motor_angles", "tip_velocity")},
            "angle_errors": np.full(view.n_joints, 2 * limits.angle),
            "target_error": np.full(3, 2 * view.reach),
            "tip_velocity": bounds["tip_velocity"],
        }
        self._scales = np.concatenate([np.full(len(largest[name]), scale) for name, scale in _scales(view, limits)])
        fine = np.arcsinh(np.concatenate(list(largest.values())) / self._scales)
        ends = np.cumsum([0, *map(len, largest.values())])
        # rounding of a quantity on its bound must not lead beyond this one
        return [
            Entry(f"fine_{name}", len(bound), "1", 1.0000001 * fine[first : first + len(bound)])
            for (name, bound), first in zip(largest.items(), ends, strict=False)
        ]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, 8 n + 6)."""
        n = view.n_joints
        out[:, : 7 * n] = view.motion[:, n : 8 * n]
        np.subtract(view.goal_angles, view.motor_angles, out=out[:, 7 * n : 8 * n])
        out[:, -6:-3], out[:, -3:] = view.target_error, view.tip_velocity
        out /= self._scales
        np.arcsinh(out, out=out)


def _scales(view: View, limits: Limits) -> list[tuple[str, float]]:
    """Names and scales in the order of the entries."""
    reach = view.reach
    return [
        ("motor_rates", RATE * limits.rate),
        ("joint_twists", TWIST * limits.twist),
        ("joint_twist_rates", RATE * limits.rate),
        ("link_deflections", DEFLECTION * reach),
        ("link_deflection_rates", LENGTH * reach),
        ("angle_errors", ANGLE * limits.angle),
        ("target_error", LENGTH * reach),
        ("tip_velocity", SPEED * reach),
    ]
