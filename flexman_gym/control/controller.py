"""Controller: the one protocol of everything that acts on arms."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from inspect import signature
from typing import Any, Protocol, runtime_checkable

from numpy.typing import NDArray

from flexman_gym.arrays import Array, Flags, IntArray
from flexman_gym.checks import check_members, refusal

Readings = Mapping[str, NDArray[Any]]
OPTIONAL = ("kept", "estimates")  # members that a controller may leave out
CALLS = {"reset": ("arms", "episode"), "act": ("readings", "applied", "playing")}


@dataclass(frozen=True, eq=False)
class Episode:
    """What a controller is told of r arms whose episodes start.

    Attributes:
        start: (r, n) joint angles at the start, rad.
        goal: (r, n) motor angles of the goal, of its first moment where it moves, rad.
        period: of control, s.
        path: makes the `reference`, None for a goal that stays.
        drawn: what these episodes drew, name -> (r, ...): physical parameters in their units, and the delay of torques
            in control periods. It is the truth, which only a privileged controller reads.
    """

    start: Array
    goal: Array
    period: float
    path: Callable[[], Array] | None = None
    drawn: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @cached_property
    def reference(self) -> Array | None:
        """Motor angles (r, T + 1, n) rad of a goal that moves, at each control period; None for one that stays."""
        return None if self.path is None else self.path()


@runtime_checkable
class Controller(Protocol):
    """The protocol of everything that acts on b arms of n joints. A class with these members needs no base class.

    A controller is built from a model, which may be wrong on purpose, and never from an environment. Its action on an
    arm must not depend on the other arms, to the last bit. Products therefore go row by row (`arrays.row_dots`,
    elementwise): products of BLAS have other last digits for other numbers of arms.

    Optional members are `kept`, () by default: names of attributes, arrays or numbers, that it remembers of an episode
    beside what `reset` gives it; states of environments then hold them. And `estimates`, {} by default: what it says of
    the arms, name -> (b, ...), which goes to `info`.

    Attributes:
        sensors: names of the sensors that it reads.
    """

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that it reads."""
        ...

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms with the indices (r,)."""
        ...

    def act(self, readings: Readings, applied: Array, playing: Flags) -> NDArray[Any]:
        """Gives the actions (b, n), parts of the torque limits from -1 to 1.

        Args:
            readings: (b, size) of each sensor, by its name.
            applied: (b, n) what the motors were asked for in the last control period, parts of the torque limits: the
                sum of all that acts, cut off at -1 and 1, before a delay or friction that nobody knows. 0 at first.
            playing: (b,) whether the episode of an arm goes on.
        """
        ...


def checked_controller(field: str, value: object, others: str = "") -> Controller:
    """Gives a value that is a Controller; `others` say what else is allowed in its place.

    Raises:
        ValueError: one line, for anything else, for methods that take something else, and for a name that is nearly
            that of an optional member.
    """
    if not isinstance(value, Controller) or isinstance(value, type):
        raise refusal(field, value, f"{others}a Controller: an object with sensors, reset and act")
    for name, wanted in CALLS.items():
        takes = signature(getattr(value, name))
        try:
            takes.bind(*wanted)
        except TypeError:
            raise refusal(f"{field}.{name}", str(takes), f"({', '.join(wanted)})") from None
    check_members(field, value, OPTIONAL, (*CALLS, "sensors"))
    return value
