"""Quantities: what instruments measure of the arms, by the names that the view has for it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import one_of, sequence, store
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors.measured import measuring_ranges
from flexman_gym.envs.sensors.sensor import Entry
from flexman_gym.simulation.view import View


@dataclass(frozen=True)
class Quantities:
    """Measured quantities of the view side by side, such as ("motor_angles", "motor_rates").

    What has a limit is measured as far as that. The rest saturates at its range: the tip and the root strains where an
    arm within its limits cannot or hardly be, accelerations at 500 m/s^2.

    Attributes:
        names: of the view, see `View.units`.

    Raises:
        ValueError: one line, for a name that the view does not have.
    """

    names: Sequence[str]

    def __post_init__(self) -> None:
        names = sequence("Quantities.names", self.names, "names of measured quantities, such as motor_angles")
        store(self, names=tuple(names))

    @property
    def measures(self) -> tuple[str, ...]:
        """Names of what is measured."""
        return tuple(self.names)

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """Says what it reads, in order."""
        ranges = measuring_ranges(view, limits)
        for name in self.names:
            one_of("Quantities.names", name, view.units)
        bounds = [ranges[name] for name in self.names]
        store(self, _bounds=bounds)
        return [Entry(name, len(each), view.units[name], each) for name, each in zip(self.names, bounds, strict=True)]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, size)."""
        end = 0
        for name, bound in zip(self.names, self._bounds, strict=True):  # type: ignore[attr-defined]
            first, end = end, end + len(bound)
            np.clip(getattr(view, name), -bound, bound, out=out[:, first:end])
