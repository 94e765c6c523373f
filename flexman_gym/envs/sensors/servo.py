"""Servo: what the drive of a motor knows, its error and its rate."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.simulation.view import View


class Servo:
    """Posture errors (goal - angle) and rates of the motors."""

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Says what it reads, in order."""
        return [
            Entry("posture_errors", view.n_joints, "rad", 2 * limits.angle),
            Entry("motor_rates", view.n_joints, "rad/s", limits.rate),
        ]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, 2 n)."""
        np.subtract(view.posture, view.motor_angles, out=out[:, : view.n_joints])
        out[:, view.n_joints :] = view.motor_rates
