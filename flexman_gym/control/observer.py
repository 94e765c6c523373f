"""Observer: the protocol of everything that estimates what an arm does from what instruments read of it."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from flexman_gym.arrays import Array, Flags, IntArray
from flexman_gym.control.controller import Episode, Readings


class Estimate(NamedTuple):
    """What is known of b arms when a controller has to act.

    Attributes:
        states: (b, 2 d) of the moment at which torques that are asked for now begin to act.
        lead: (b,) whole control periods from now to that moment.
        parameters: name -> (b, ...) physical parameters as they are estimated, in their units; those that are not in it
            are the model's.
        disturbance: (b, n) constant torques on the motors beside those that are asked for, N m.
    """

    states: Array
    lead: IntArray
    parameters: Mapping[str, Array]
    disturbance: Array | float = 0.0


class Observer(Protocol):
    """The protocol of an observer of b arms. Its estimate of an arm must not depend on the others, to the last bit.

    An optional member is `kept`, as of a Controller.

    Attributes:
        sensors: names of the sensors that it reads.
    """

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that it reads."""
        ...

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms (r,)."""
        ...

    def estimate(self, readings: Readings, applied: Array, playing: Flags) -> Estimate:
        """Gives what is known now; arguments are those of `Controller.act`, and it is asked once a control period."""
        ...
