"""Action: what the motors were asked for, by agent and base together, which nothing has to measure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from flexman_gym.arrays import Array
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.simulation.view import View


@dataclass
class Action:
    """The sum of agent and base in the last control period after clipping, parts of the torque limits; 0 at first.

    Delays, friction and other effects between a command and the torque of a motor are not in it.
    """

    measures: ClassVar[tuple[str, ...]] = ()

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Says what it reads, in order."""
        return [Entry("action", view.n_joints, "1", 1.0)]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, n)."""
        out[:] = view.action
