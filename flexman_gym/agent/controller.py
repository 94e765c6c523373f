"""Controller protocol, information given at the start of an episode, and plant model for controller design."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from inspect import Signature, signature
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector
from flexman_gym.common.checks import check_member_names
from flexman_gym.common.errors import value_error
from flexman_gym.model.model import Model
from flexman_gym.simulation.methods import DEFAULT_METHOD, Method

Gains = Mapping[str, Vector]

NO_MOTOR = 1e30  # N m; torque limit by which a passive joint has an action of zero


def torque_scales(torque_limit: Vector) -> Array:
    """Return the torques (n,) of unit action, N m: the limits (n,), and NO_MOTOR in place of 0 for passive joints."""
    limits = np.array(torque_limit, dtype=float)
    return np.where(limits > 0.0, limits, NO_MOTOR)


class Plant(NamedTuple):
    """Plant model and specifications for controller design.

    Attributes:
        model: nominal model of the arm.
        torque_limit: (n,) torque limits, N m.
        period: control period, s.
        gains: function that returns PD gains tuned for the arm: "stiffness" (N m/rad) and "damping" (N m s/rad), (n,)
            each.
        unknown: uncertain parameters: name -> range (low, high). The names are the keys of
            `physical_parameters.UNCERTAIN`, with the units of its parameters: "payload_mass" (kg),
            "joint_stiffness_factor" (relative), and so on; none of `physical_parameters.UNMODELLED`.
        delay: (2,) smallest and largest delay of the torques, whole control periods.
        integration: integration method and step (s) of simulations.
        tip_force: magnitude of unmeasured forces on the tip, N.
        measured: function that returns, for each measured quantity, its range, the standard deviation of its noise and
            the largest magnitude of its bias, in the unit of the quantity, and its largest relative gain error:
            name -> (4, size).
        bandwidth: bandwidth of a first-order lag between commanded and applied torques, Hz; None for no lag.
        rate_limit: largest magnitude of a motor rate in the environment, rad/s.
        named_period: control period of the named environment whose arm this is, s; None for another arm.
        foundation: settings of a foundation that the agent commands; None for a fixed one.
        link_encoders: True for an environment whose instruments are encoders of the link side: output feedback reads
            them alone unless its sensors are named.
    """

    model: Model
    torque_limit: tuple[float, ...]
    period: float
    gains: Callable[[], Gains]
    unknown: Mapping[str, tuple[float, float]] = {}
    delay: tuple[int, int] = (0, 0)
    integration: tuple[str | Method, float | str] = (DEFAULT_METHOD, "auto")
    tip_force: float = 0.0
    measured: Callable[[], Mapping[str, Array]] = dict
    bandwidth: float | None = None
    rate_limit: float = np.inf
    named_period: float | None = None
    foundation: Any = None
    link_encoders: bool = False

    @property
    def torque_scales(self) -> Array:
        """Torques (n,) of unit action, N m, see the function `torque_scales`."""
        return torque_scales(self.torque_limit)


Readings = Mapping[str, NDArray[Any]]
OPTIONAL_MEMBERS = ("state_fields", "estimates", "derivatives", "prepare", "skip")  # members that a controller may omit
METHOD_ARGUMENTS = {"reset": ("arms", "episode", "count"), "act": ("readings", "applied", "active")}


@dataclass(frozen=True, eq=False)
class EpisodeInfo:
    """Information given to a controller at the start of the episodes of r arms.

    Attributes:
        start: (r, n) joint angles at the start, rad.
        goal: (r, n) motor angles of the goal, rad; for a moving goal, of the goal at the start.
        period: control period, s.
        path: function that returns `reference`; None for a fixed goal.
        drawn: name -> (r, ...) randomised true values of these episodes, for privileged controllers only: physical
            parameters in their units without those of `physical_parameters.UNMODELLED`, and the delay of the torques
            in control periods.
        travel: (r, 2) start and goal of the foundation along its axis, m; None for a fixed foundation.
    """

    start: Array
    goal: Array
    period: float
    path: Callable[[], Array] | None = None
    drawn: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    travel: Array | None = None

    @cached_property
    def reference(self) -> Array | None:
        """Motor angles (r, T + 1, n) of a moving goal at the control periods, rad; None for a fixed goal."""
        return None if self.path is None else self.path()


@runtime_checkable
class Controller(Protocol):
    """Protocol of controllers of b arms with n joints. A class with these members needs no base class.

    A controller is constructed from a model, which may deliberately be wrong, and never from an environment. Its
    action for an arm must not depend on the other arms, to the last bit. Compute products row by row
    (`arrays.row_dots`, elementwise operations): the last digits of BLAS products depend on the number of rows.

    Five members are optional. `state_fields`, () by default, lists the attributes (arrays or numbers) that change
    during an episode and cannot be recomputed by `reset`; these attributes become part of the state of an environment.
    `estimates`, {} by default, maps names to estimates (b, ...), which are added to `info`. `derivatives(readings,
    changes)` is called before `act` for an episode of one arm, and returns the actions (1, n) of this period and their
    derivatives (p, n) with respect to p parameters, for the readings and their derivatives, name -> (p, size). The
    parameters may include gains of the controller, named by an attribute `gain_units`, name -> unit: `changes` then has
    their derivatives (p, n), too. `prepare(applied, active)`, with arguments of the next `act`, computes what this call
    needs besides its readings. `flexman drive` calls it before the readings arrive; the actions are those without it.
    `skip(active)` is called in place of `act` in a control period without good readings, see `RangeCheckedController`:
    references that are functions of time go on by a period, and all else remains unchanged.

    Two members serve the export as C. `c_program`, an attribute of the class itself, is the place "module:function" of
    a function of the controller and the names of its readings, which returns its tables and statements in C, see
    `toolbox.deployment.c_programs`. `linear_form()` returns the linear controller that is exported in its place.

    Attributes:
        sensors: names of the sensors that the controller reads.

    Examples:
        >>> import numpy as np
        >>> from flexman_gym.control import PD, Controller, EpisodeInfo
        >>> pd = PD(stiffness=[40.0, 6.0], damping=[9.0, 1.3], torque_limit=10.0)
        >>> isinstance(pd, Controller), pd.sensors
        (True, ('servo',))
        >>> start, goal = np.zeros((1, 2)), np.array([[0.3, -0.2]])
        >>> pd.reset(np.array([0]), EpisodeInfo(start, goal, period=0.01), count=1)
        >>> readings = {"angle_errors": goal - start, "motor_rates": np.zeros((1, 2))}
        >>> pd.act(readings, applied=np.zeros((1, 2)), active=np.array([True])).astype(float).round(2).tolist()
        [[1.0, -0.12]]
    """

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that the controller reads."""
        ...

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes of some arms.

        Args:
            arms: (r,) indices.
            episode: start, goal and control period of these episodes.
            count: total number of arms.
        """
        ...

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> NDArray[Any]:
        """Return the actions (b, n): torques as fractions of the torque limits, from -1 to 1.

        Args:
            readings: sensor name -> (b, size).
            applied: (b, n) torques commanded in the previous control period, as fractions of the torque limits: the
                sum of all controllers, saturated at -1 and 1, before delay and friction; 0 in the first period.
            active: (b,) True for arms whose episode is running.
        """
        ...


def saturated(values: Array, changes: Array) -> tuple[Array, Array]:
    """Return actions (1, n) clipped to -1 and 1, and their derivatives (p, n), which are 0 at a limit."""
    return np.clip(values, -1.0, 1.0), np.where(np.abs(values) < 1.0, changes, 0.0)


def checked_controller(field: str, value: object, others: str = "") -> Controller:
    """Return a value that satisfies the `Controller` protocol.

    Args:
        field: name of the field, for error messages.
        value: any object.
        others: text with further allowed values, for error messages.

    Raises:
        ValueError: for an object without these members, for methods with different arguments, and for a member whose
            name resembles the name of an optional member.
    """
    if not isinstance(value, Controller) or isinstance(value, type):
        raise value_error(field, value, f"{others}a Controller: an object with sensors, reset and act")
    for name, expected in METHOD_ARGUMENTS.items():
        call = signature(getattr(value, name))
        if not _accepts(call, expected):
            raise value_error(f"{field}.{name}", str(call), f"({', '.join(expected)})")
    check_member_names(field, value, OPTIONAL_MEMBERS, (*METHOD_ARGUMENTS, "sensors"))
    return value


def _accepts(call: Signature, arguments: Sequence[str]) -> bool:
    try:
        call.bind(*arguments)
    except TypeError:
        return False
    return True
