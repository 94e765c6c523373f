"""Command: what the arm was told to do, which nothing has to measure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from flexman_gym.arrays import Array
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.simulation.view import View


@dataclass
class Command:
    """The goal as it is now: angles and rates of the motors, target of the tip in the base frame and its velocity.

    A task with a path may add what comes next, see `Track`.
    """

    measures: ClassVar[tuple[str, ...]] = ()

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Says what it reads, in order."""
        return [
            Entry("angle_command", view.n_joints, "rad", limits.angle),
            Entry("rate_command", view.n_joints, "rad/s", limits.rate),
            Entry("tip_command", 3, "m", (1.0 + limits.deflection) * view.reach),
            Entry("tip_velocity_command", 3, "m/s", limits.tip_speed),
        ]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, 2 n + 6)."""
        n = view.n_joints
        out[:, :n], out[:, n : 2 * n] = view.goal_angles, view.goal_rates
        out[:, -6:-3], out[:, -3:] = view.target, view.target_velocity
