"""State: the coordinates and speeds of the model itself, which no instrument gives."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from flexman_gym.arrays import Array
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.kernels.layout import LARGEST_STATE
from flexman_gym.simulation.view import View


@dataclass
class State:
    """The state (2 d,) of the model in the order of `kernels.layout`; its size depends on the fidelity of the model."""

    measures: ClassVar[tuple[str, ...]] = ()

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Says what it reads, in order."""
        return [Entry("state", view.state.shape[-1], "rad, m, rad/s, m/s", LARGEST_STATE)]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, 2 d)."""
        out[:] = view.state
