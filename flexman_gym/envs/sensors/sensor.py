"""Sensor: what one kind of instrument reads of the arms, and several side by side as an observation."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from flexman_gym.arrays import Array
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
    others, to the last bit (no matrix products over the arms). An environment copies it and asks for its `entries`
    first.

    Noise and other flaws act on what it measures, before it derives anything. `measures`, names of the view, says what
    that is: () for nothing; a sensor without this attribute measures motion, tip and deflection.
    """

    def entries(self, view: View, limits: Limits) -> Sequence[Entry]:
        """What it reads, in order. While an arm is within its limits, no number may be beyond the bound given here."""
        ...

    def read(self, view: View, out: Array) -> None:
        """Writes what it reads into out (b, size), the entries side by side."""
        ...
