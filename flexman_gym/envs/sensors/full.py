"""Full state: every mechanical quantity and the goal, seen without any instrument's limits."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from flexman_gym.arrays import Array
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.kernels.readings import read_everything
from flexman_gym.simulation.view import View

NEAR = 0.1 / 8.5  # of the reach: tip error that is half of the way to the largest nearness


@dataclass
class FullState:
    """The whole mechanical state in physical quantities whose number does not depend on the fidelity of the model.

    For n joints: motor angles and rates, joint twists and their rates, deflections of the links and their rates, then
    the goal: angle errors, the error of the tip and its nearness, and the velocity of the tip; `FlexManEnv` has units
    and bounds. The nearness is the error again on a scale that still tells millimetres when normalised by the metres of
    a slew: error / (NEAR reach + its length).
    """

    measures: ClassVar[tuple[str, ...]] = ("motion", "tip")

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """What it reads, in order."""
        bounds, n = limits.bounds(view), view.n_joints
        speed = bounds.pop("tip_velocity")
        return [
            *(Entry(name, len(bound), view.units[name], bound) for name, bound in bounds.items()),
            Entry("angle_errors", n, "rad", 2 * limits.angle),
            Entry("target_error", 3, "m", 2 * view.reach),
            Entry("target_nearness", 3, "1", 1.0),
            Entry("tip_velocity", 3, "m/s", speed),
        ]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, 9 n + 9)."""
        read_everything(
            view.motion, view.motor_angles, view.tip_velocity, view.goal_angles, view.target_error, view.tip_error,
            NEAR * view.reach, out,
        )  # fmt: skip
