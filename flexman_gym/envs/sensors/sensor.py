"""Sensor: what one kind of instrument reads of the arms, and several side by side as an observation."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.envs.limits import Limits
from flexman_gym.simulation.view import View


class Entry(NamedTuple):
    """A named part of an observation: how many numbers, their unit, and their largest magnitude, one or one of each."""

    name: str
    size: int
    unit: str
    bound: float | Array


@runtime_checkable
class Sensor(Protocol):
    """An instrument. A class with these two methods is one; it needs no base class.

    It reads the view and nothing else, and keeps nothing of one arm: what it reads of an arm must not depend on the
    others, to the last bit (no matrix products over the arms). One object serves one environment, whose `entries` are
    asked first.
    """

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """What it reads, in order. While an arm is within its limits, no number may be beyond the bound given here."""
        ...

    def read(self, view: View, out: Array) -> None:
        """Writes what it reads into out (b, size), the entries side by side."""
        ...


class Sensors:
    """Sensors side by side.

    Attributes:
        slices, units: name -> slice of the observation, and unit.
        bound: (size,) largest magnitude of each number.
        observations: (b, size) of the last reading, which the next one overwrites.
        readings: name -> (b, ...) its part of that entry.

    Raises:
        ValueError: for something else than sensors, and for two entries of one name.
    """

    def __init__(self, parts: Sequence[object], view: View, limits: Limits) -> None:
        self.slices: dict[str, slice] = {}
        self.units: dict[str, str] = {}
        self._parts: list[tuple[Sensor, slice]] = []
        bounds, end = [np.zeros(0)], 0
        for part in parts:
            if not isinstance(part, Sensor):
                raise refusal("sensors", part, "a Sensor: an object with the methods entries and read")
            first = end
            for name, size, unit, bound in part.entries(view, limits):
                if name in self.slices:
                    raise refusal("sensors", name, "every entry once: two of them read this")
                self.slices[name], self.units[name], end = slice(end, end + size), unit, end + size
                bounds.append(np.ones(size) * np.asarray(bound))
            self._parts.append((part, slice(first, end)))
        self.bound: Array = np.concatenate(bounds)
        self.observations = np.zeros((len(view.motion), end))
        self.readings = {name: self.observations[:, place] for name, place in self.slices.items()}
        self._view, self._outs = view, [(part, self.observations[:, place]) for part, place in self._parts]

    def read(self) -> None:
        """Reads the view."""
        for part, out in self._outs:
            part.read(self._view, out)
