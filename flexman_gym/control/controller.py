"""Controller protocol, the data of an episode that a controller is given, and the plant for which it is designed."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from inspect import Signature, signature
from typing import Any, NamedTuple, Protocol, runtime_checkable

from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector
from flexman_gym.common.checks import check_member_names, value_error
from flexman_gym.model.model import Model
from flexman_gym.simulation.methods import DEFAULT_METHOD, Method

Gains = Mapping[str, Vector]


class Plant(NamedTuple):
    """What a controller is made for.

    Attributes:
        model: of the arm, as the base knows it.
        torque_limit: (n,) N m.
        period: of control, s.
        gains: makes "stiffness" (N m/rad) and "damping" (N m s/rad) that were tuned for the arm, (n,) each.
        unknown: ranges (low, high) of the uncertain parameters, with the names and units of a randomisation, see
            `simulation.parameters.UNCERTAIN`: "payload_mass" (kg), "joint_stiffness_factor" (1), and so on.
        delay: fewest and most whole control periods by which torques come late.
        moved: method and step (s) by which the arm is simulated.
        push: N, how large forces on the tip may be that nobody tells.
        measured: gives, name -> (2, size), the range of each quantity that instruments measure and the standard
            deviation of their noise, in its unit.
        bandwidth: Hz, of drives that follow what they are asked for as a first-order lag; None for such that do so at
            once.
    """

    model: Model
    torque_limit: tuple[float, ...]
    period: float
    gains: Callable[[], Gains]
    unknown: Mapping[str, tuple[float, float]] = {}
    delay: tuple[int, int] = (0, 0)
    moved: tuple[str | Method, float | str] = (DEFAULT_METHOD, "auto")
    push: float = 0.0
    measured: Callable[[], Mapping[str, Array]] = dict
    bandwidth: float | None = None


Readings = Mapping[str, NDArray[Any]]
OPTIONAL_MEMBERS = ("state_fields", "estimates")  # members that a controller may leave out
METHOD_ARGUMENTS = {"reset": ("arms", "episode", "count"), "act": ("readings", "applied", "playing")}


@dataclass(frozen=True, eq=False)
class EpisodeInfo:
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

    Optional members are `state_fields`, () by default: names of attributes, arrays or numbers, that it remembers of an episode
    beside what `reset` gives it; states of environments then hold them. And `estimates`, {} by default: what it says of
    the arms, name -> (b, ...), which goes to `info`.

    Attributes:
        sensors: names of the sensors that it reads.
    """

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that it reads."""
        ...

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes of the arms with the indices (r,), of `count` arms in all."""
        ...

    def act(self, readings: Readings, applied: Array, playing: BoolArray) -> NDArray[Any]:
        """Gives the actions (b, n), parts of the torque limits from -1 to 1.

        Args:
            readings: (b, size) of each sensor, by its name.
            applied: (b, n) what the motors were asked for in the last control period, parts of the torque limits: the
                sum of all that acts, cut off at -1 and 1, before a delay or friction that nobody knows. 0 at first.
            playing: (b,) whether the episode of an arm goes on.
        """
        ...


def checked_controller(field: str, value: object, others: str = "") -> Controller:
    """Return a value that is a Controller; `others` say what else is allowed in its place.

    A `reset` without the number of arms, that of version 0.2, is adapted, with a DeprecationWarning.

    Raises:
        ValueError: one line, for anything else, for methods that take something else, and for a name that is nearly
            that of an optional member.
    """
    if not isinstance(value, Controller) or isinstance(value, type):
        raise value_error(field, value, f"{others}a Controller: an object with sensors, reset and act")
    former = False
    for name, wanted in METHOD_ARGUMENTS.items():
        takes = signature(getattr(value, name))
        if not _takes(takes, wanted):
            former = name == "reset" and _takes(takes, wanted[:2])
            if not former:
                raise value_error(f"{field}.{name}", str(takes), f"({', '.join(wanted)})")
    check_member_names(field, value, OPTIONAL_MEMBERS, (*METHOD_ARGUMENTS, "sensors"))
    return _FormerController(value, field) if former else value


def _takes(takes: Signature, arguments: Sequence[str]) -> bool:
    try:
        takes.bind(*arguments)
    except TypeError:
        return False
    return True


class _FormerController:
    """Adapter of a controller with `reset(arms, episode)`, the protocol of version 0.2."""

    state_fields = ("inner",)

    def __init__(self, inner: Any, field: str) -> None:
        said = f"{field}.reset(arms, episode) is deprecated; give reset(arms, episode, count), with the number of arms"
        warnings.warn(said, DeprecationWarning, stacklevel=6)
        self.inner, self.act = inner, inner.act

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that it reads."""
        names: tuple[str, ...] = self.inner.sensors
        return names

    @property
    def estimates(self) -> Mapping[str, Array]:
        """Estimates of the controller, name -> (b, ...)."""
        return getattr(self.inner, "estimates", {})

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes of the arms (r,)."""
        self.inner.reset(arms, episode)
