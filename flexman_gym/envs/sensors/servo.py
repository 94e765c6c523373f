"""Servo: what the drive of a motor knows, its error, its rate and the rate that is wanted."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.simulation.view import View


@dataclass
class Servo:
    """Posture errors (goal - angle) and rates of the motors, and the rates of a goal that moves."""

    measures: ClassVar[tuple[str, ...]] = ("motor_angles", "motor_rates")

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Says what it reads, in order."""
        return [
            Entry("angle_errors", view.n_joints, "rad", 2 * limits.angle),
            Entry("motor_rates", view.n_joints, "rad/s", limits.rate),
            Entry("goal_rates", view.n_joints, "rad/s", limits.rate),
        ]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, 3 n)."""
        n = view.n_joints
        np.subtract(view.goal_angles, view.motor_angles, out=out[:, :n])
        out[:, n : 2 * n], out[:, 2 * n :] = view.motor_rates, view.goal_rates
