"""Quantities: what instruments measure of the arms, by the names that the view has for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

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
        ends = np.cumsum([0, *map(len, bounds)]).tolist()
        places = [slice(*both) for both in pairwise(ends)]
        # what has a limit needs no clipping: an arm beyond it has no outcome worth seeing
        ranges_of = [None if name in view.places else bound for name, bound in zip(self.names, bounds, strict=True)]
        store(self, _plan=list(zip(self.names, places, ranges_of, strict=True)))
        return [Entry(name, len(each), view.units[name], each) for name, each in zip(self.names, bounds, strict=True)]

    def read(self, view: View, out: Array) -> None:
        """Writes into out (b, size)."""
        for name, place, bound in self._plan:  # type: ignore[attr-defined]
            if bound is None:
                out[:, place] = getattr(view, name)
            else:
                np.maximum(getattr(view, name), -bound, out=out[:, place])
                np.minimum(out[:, place], bound, out=out[:, place])
