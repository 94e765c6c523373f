"""Controller: the one call signature of everything that acts on arms."""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array, IntArray


@runtime_checkable
class Controller(Protocol):
    """The protocol of everything that acts on b arms of n joints. A class with these members needs no base class.

    A controller is built from a model, which may be wrong on purpose, and never from an environment. Its action on an
    arm must not depend on the other arms, to the last bit. Products therefore go row by row (`arrays.row_dots`,
    elementwise): products of BLAS have other last digits for other numbers of arms.

    One that remembers more of an episode than `reset` gives it names these attributes, arrays or numbers, in a further
    one, `kept`: states of environments then hold them.

    Attributes:
        sensors: names of the sensors that it reads.
    """

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that it reads."""
        ...

    def reset(self, arms: IntArray, start: Array, posture: Array) -> None:
        """Starts new episodes.

        Args:
            arms: indices (r,) of the arms that start.
            start: (r, n) joint angles at the start, rad.
            posture: (r, n) joint angles of the goal, rad.
        """
        ...

    def act(self, readings: Mapping[str, NDArray[np.floating]]) -> NDArray[np.floating]:
        """Gives the actions (b, n), parts of the torque limits from -1 to 1.

        Args:
            readings: (b, size) of each sensor, by its name. Readings of a single arm, (size,), give its action (n,).
        """
        ...
