"""Controller: the one call signature of everything that acts on arms."""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array, IntArray


@runtime_checkable
class Controller(Protocol):
    """What acts on b arms of n joints. A class with these members is one; it needs no base class.

    It is built from a model, which may be wrong on purpose, and never from an environment. What it does to an arm must
    not depend on the others, to the last bit: products go row by row (`np.vecdot`, elementwise), as those of BLAS have
    other last digits for other numbers of arms.

    Attributes:
        sensors: names of the sensors that it reads.
    """

    @property
    def sensors(self) -> tuple[str, ...]:
        """See the class."""
        ...

    def reset(self, arms: IntArray, start: Array, posture: Array) -> None:
        """New episodes of the arms with the indices (r,), from joint angles (r, n) rad to goal postures (r, n) rad."""
        ...

    def act(self, readings: Mapping[str, NDArray[np.floating]]) -> NDArray[np.floating]:
        """Actions (b, n), parts of the torque limits from -1 to 1, for what the sensors read: name -> (b, size).

        Readings without the axis of the arms, (size,), give the action (n,) of one.
        """
        ...
