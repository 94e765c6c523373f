"""Setup: checked settings of an environment, and the model of its fidelity."""

import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches
from typing import Any, NamedTuple

from flexman_gym.common.checks import (
    mapping,
    one_of,
    physical,
    positive,
    sequence,
    set_fields,
    text,
    value_error,
    vector,
    whole_number,
)
from flexman_gym.control.actions import ActionMode, checked_action_mode
from flexman_gym.control.agent import checked_history
from flexman_gym.control.base_controllers import BASES, checked_base, make_base
from flexman_gym.control.controller import Controller, checked_controller
from flexman_gym.control.margins import first_order_lag
from flexman_gym.control.pd import PD, torque_limits
from flexman_gym.envs.config.fidelity import choose_fidelity
from flexman_gym.envs.config.hints import HINTS
from flexman_gym.envs.config.named_environments import DEFAULT, NAMED
from flexman_gym.envs.config.randomisation import Randomisation, find_randomisation
from flexman_gym.envs.config.specification import make_plant
from flexman_gym.envs.limits import Limits, find_limits
from flexman_gym.envs.sensors import find_sensors
from flexman_gym.envs.tasks import Task, check_task, find_task
from flexman_gym.envs.tasks.rewards import checked_reward
from flexman_gym.fidelity.choose import Choice, assembled_modes
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.mistakes import warn_of_units
from flexman_gym.scene.serialization import find_arm
from flexman_gym.simulation.integrator import default_step
from flexman_gym.simulation.methods import DEFAULT_METHOD as DEFAULT_METHOD
from flexman_gym.simulation.methods import Method
from flexman_gym.simulation.trajectory import ENERGY_ALARM

CHOSEN = ("elements", "modes", "method", "step", "stiffening")  # by fidelity="auto"
SHORTEST_PERIOD, LONGEST_PERIOD = 1e-9, 100.0  # s, of control
LONGEST_HOLD, MOST_PERIODS = 1000, 10**9


@dataclass(frozen=True, eq=False)
class Setup:
    """What an environment is made of; the keyword arguments of `gym.make` and `gym.make_vec`.

    Attributes:
        name: of a named environment, which gives what is None below.
        arm: an Arm, or what `scene.serialization.find_arm` takes for one.
        task: a Task, such as `Slew()`; its name, "slew"; or a mapping with that at "kind" and its arguments.
        reward: weights of the task's terms, name -> factor, which is 1 for the others; or a function that gives the
            reward (b,) of a View in their place, a failure included (`view.failed`). None for the terms as they are.
        sensors: a name, a mapping with a name at "kind" and flaws (noise, bias, quantisation, delay, every, dropped),
            a Sensor of one's own, or a tuple of these; `envs.sensors` has the names.
        history: the agent sees the last k observations, the newest first; or, for a tuple of times (s), the present one
            and exponential averages of all with these times.
        limits: a Limits.
        torque_limit: N m, of the motors, one number or one for each joint; None takes what the joints of the arm say.
            Stored as a tuple.
        control_period: s.
        horizon: s, after which an episode is truncated.
        base: what acts beside the agent in every control period, so that its action is a residual: a name in
            `control.BASES`, "pd" for the PD controller that was tuned for the arm of the named environment, "lqr" or
            "lqr-tracking" for the optimal ones that know the true state; a mapping with a name at "kind" and its
            arguments; or a Controller of one's own. None for nothing. The sum of both saturates.
        gains: of base="pd", a mapping with "stiffness" (N m/rad) and "damping" (N m s/rad), one for each joint; None
            takes those that were tuned for the arm of the named environment, which no arm with other links or motors
            has.
        actions: what an action of the agent means: a name in `control.actions.ACTIONS`, "torque" for torques as parts
            of their limits, "current" of motors, "position" or "velocity" of their servos, or "shaping" for the
            reference that the base tracks; a mapping with a name at "kind" and its arguments; or an ActionMode that is
            made already, with its base. A servo acts in every
            control period: with control_period=0.002 and hold=10 it runs at 500 Hz under an agent at 50 Hz.
        drive_bandwidth: Hz, with which the torque of a motor follows what it is asked for, as a first-order lag; None
            for at once.
        hold: control periods for which the agent's part of an action is kept (action repeat). A step then takes so
            many: its reward is the mean of theirs, its info that of the last; an episode that ends on the way ends
            there.
        fidelity: "default" or "auto"; the latter with a tolerance, and without the next four.
        tolerance: m, largest error of the tip in a slew.
        stiffening: foreshortening of bent links, see `build_model`.
        spinning_rotors: rotors turn with the links that carry them, see `ModelChoice`.
        rotary_inertia: sections of links resist turning, see `ModelChoice`.
        elements: of each link, see `build_model`.
        modes: see `build_model`; "assembled" ones are those of `assembled_modes` below half the control frequency.
        method: a name in `METHODS`, or a Method.
        step: s; None takes the longest that divides the control period, up to the `longest_step` of the environment.
        tell: names in `View.units` whose quantities go to `info`; "action" is what motors were asked for.
        energy_alarm: part of the energy turned over (the largest of kinetic + elastic energy, work and dissipation).
        randomisation: a Randomisation, or a dict of its arguments; None for none.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    name: str = DEFAULT
    arm: Arm = None  # type: ignore[assignment]
    task: Task = None  # type: ignore[assignment]
    reward: Any = None
    sensors: Any = None
    history: Any = 1
    limits: Limits = None  # type: ignore[assignment]
    torque_limit: Any = None
    control_period: float = None  # type: ignore[assignment]
    horizon: float = None  # type: ignore[assignment]
    base: Controller | Mapping[str, Any] | str | None = None
    gains: Any = None
    actions: Any = "torque"
    drive_bandwidth: float | None = None
    hold: int = 1
    fidelity: str = "default"
    tolerance: float | None = None
    elements: int | tuple[int, ...] = 2
    modes: int | tuple[int | tuple[int, ...], ...] | str | None = "assembled"
    method: str | Method = DEFAULT_METHOD
    step: float | None = None
    stiffening: bool = False
    spinning_rotors: bool = False
    rotary_inertia: bool = True
    tell: Any = ()
    energy_alarm: float = ENERGY_ALARM
    randomisation: Randomisation | None = None

    def __post_init__(self) -> None:
        named = NAMED[one_of("name", self.name, NAMED)]
        for field, kind, allowed in (
            ("arm", Arm, "an Arm"),
            ("task", Task, "a task: an object with sensors, moves, draw, goal, reward_terms and info, such as Slew()"),
            ("limits", Limits, "Limits"),
        ):
            value = getattr(self, field)
            if isinstance(value, str | dict) or (field == "arm" and value is not None):  # names, specifications as JSON
                value = {"arm": find_arm, "task": find_task, "limits": find_limits}[field](value)
            if value is None:
                value = named.arm() if field == "arm" else getattr(named, field)
            elif not isinstance(value, kind) or isinstance(value, type):
                raise value_error(field, value, allowed)
            set_fields(self, **{field: value})
        period = named.control_period if self.control_period is None else self.control_period
        set_fields(
            self,
            sensors=find_sensors(named.sensors if self.sensors is None else self.sensors),
            torque_limit=self._torque_limits(),
            control_period=_period(period),
            energy_alarm=positive("energy_alarm", self.energy_alarm),
            randomisation=find_randomisation(self.randomisation),
            history=checked_history(self.history),
            reward=checked_reward(self.reward),
            tell=tuple(text(f"tell[{i}]", name) for i, name in enumerate(sequence("tell", self.tell, "names"))),
        )
        horizon = named.horizon if self.horizon is None else self.horizon
        set_fields(
            self, horizon=positive("horizon", horizon, "s"), hold=whole_number("hold", self.hold, 1, LONGEST_HOLD)
        )
        if not 0.5 <= self.horizon / self.control_period <= MOST_PERIODS:
            raise value_error("horizon", horizon, f"1 to {MOST_PERIODS} control periods of {self.control_period} s")
        warn_of_units("", {"horizon": self.horizon})
        check_task(self.task)
        if isinstance(self.base, str | dict):
            checked_base(self.base)
        elif self.base is not None:
            set_fields(self, base=checked_controller("base", self.base, f"None, one of {', '.join(BASES)}, or "))
        if not isinstance(self.actions, ActionMode):
            checked_action_mode(self.actions)
        if self.drive_bandwidth is not None:
            set_fields(self, drive_bandwidth=physical("drive_bandwidth", self.drive_bandwidth, "Hz"))
        if self.base == "pd":
            set_fields(self, gains=self.pd_gains)
        self._check_fidelity()

    def _torque_limits(self) -> tuple[float, ...]:
        """What is given, or what the joints say."""
        arm, own = self.arm, [joint.torque_limit for joint in self.arm.joints]
        if self.torque_limit is not None:
            return torque_limits("torque_limit", self.torque_limit, arm.n_joints)
        if None in own:
            allowed = "one number (N m), or one for each joint: the joints of this arm have no torque_limit"
            raise value_error("torque_limit", None, allowed)
        return torque_limits("torque_limit", own, arm.n_joints)

    def _check_fidelity(self) -> None:
        """Refuses what contradicts the choice of a fidelity."""
        if one_of("fidelity", self.fidelity, ("default", "auto")) == "default":
            if self.tolerance is not None:
                raise value_error("tolerance", self.tolerance, 'None without fidelity="auto"')
            if isinstance(self.modes, str):
                one_of("modes", self.modes, ("assembled",))
            return
        for each in fields(self):
            if each.name in CHOSEN and getattr(self, each.name) != each.default:
                raise value_error(each.name, getattr(self, each.name), 'nothing: fidelity="auto" chooses it')
        positive("tolerance", self.tolerance, 'm, for fidelity="auto"')

    @property
    def disturbed(self) -> Randomisation | None:
        """The randomisation with what the task disturbs the arms by, unless the former says otherwise."""
        task, own = dict(getattr(self.task, "disturbances", {})), self.randomisation
        if not task:
            return own
        return Randomisation(**task | (own.given if own else {}))

    @property
    def latest_delay(self) -> int:
        """Whole control periods by which torques may come late."""
        delay = self.disturbed.delay if self.disturbed else None
        return int(delay[1]) if delay else 0

    @property
    def lag(self) -> tuple[float, float] | None:
        """How drives of that bandwidth pass a control period, see `control.margins.first_order_lag`; None for at
        once.
        """
        return None if self.drive_bandwidth is None else first_order_lag(self.control_period, self.drive_bandwidth)

    @property
    def longest(self) -> int:
        """Control periods after which an episode is truncated."""
        return max(1, round(self.horizon / self.control_period))

    @property
    def pd_gains(self) -> dict[str, tuple[float, ...]]:
        """The `gains`, or those that were tuned for the arm of the named environment.

        Raises:
            ValueError: for another arm without gains of its own; a payload or friction makes no other arm.
        """
        named, gains = NAMED[self.name], self.gains
        if gains is None:
            if _links_and_motors(self.arm) != _links_and_motors(named.arm()):
                allowed = f"those of this arm, which flexman tune finds: {self.name} has other links or motors"
                raise value_error("gains", None, allowed)
            return dict(named.pd)
        gains = mapping("gains", gains, ("stiffness", "damping"))
        if len(gains) < 2:
            raise value_error("gains", gains, "a mapping with stiffness (N m/rad) and damping (N m s/rad)")
        return {name: vector(f"gains.{name}", each, self.arm.n_joints) for name, each in gains.items()}

    def controller(self, base: object, model: Model) -> Controller:
        """What a name in BASES, or a mapping with arguments, means for this environment and a model of its arm."""
        return make_base(base, make_plant(self, model))

    def base_controller(self, model: Model) -> Controller | None:
        """What acts beside the agent, for the model of the environment.

        It warns (UserWarning) where sampling and delay make a PD unstable.
        """
        if not isinstance(self.base, str | dict):
            return self.base  # type: ignore[return-value]
        result = self.controller(self.base, model)
        said = result.unstable(model, self.control_period, self.latest_delay) if isinstance(result, PD) else ""
        if said:
            warnings.warn(said, stacklevel=2)
        return result


def _period(value: object) -> float:
    """A control period, s."""
    period = positive("control_period", value, "s")
    if not SHORTEST_PERIOD <= period <= LONGEST_PERIOD:
        raise value_error("control_period", value, f"a number from {SHORTEST_PERIOD:g} to {LONGEST_PERIOD:g} (s)")
    warn_of_units("", {"control_period": period})
    return period


class _Fidelity(NamedTuple):
    """What a setup asks for: the model, how it is moved, and the Choice of fidelity="auto", else None."""

    model: Model
    method: str | Method
    step: float
    choice: Choice | None


def build(setup: Setup) -> _Fidelity:
    """Builds the model of a setup, or lets `choose_model` choose it."""
    if setup.fidelity == "auto":
        choice = choose_fidelity(setup)
        return _Fidelity(choice.model, choice.method, choice.step, choice)
    modes = setup.modes
    if isinstance(modes, str):
        modes = assembled_modes(setup.arm, setup.elements, 0.5 / setup.control_period)
    switches = {name: getattr(setup, name) for name in ("stiffening", "spinning_rotors", "rotary_inertia")}
    model = build_model(setup.arm, setup.elements, modes, **switches)
    step = setup.step
    if step is None:
        step = default_step(setup.control_period, NAMED[setup.name].longest_step)
    return _Fidelity(model, setup.method, step, None)


def setup_of(settings: dict[str, Any], others: Collection[str] = ()) -> Setup:
    """The setup of keyword arguments; `others` are those that an environment has beside them.

    Raises:
        ValueError: for an unknown keyword, with the nearest known one.
    """
    known = [*(each.name for each in fields(Setup)), *others]
    for name, value in settings.items():
        if name not in known:
            near = get_close_matches(name, known, 1, 0.0)[0]
            allowed = f"a known setting: the nearest is {near}; all: {' '.join(sorted(known))}"
            raise value_error(name, value, HINTS.get(name, allowed))
    return Setup(**settings)


def _links_and_motors(arm: Arm) -> tuple[object, ...]:
    """What gains of a PD are tuned for."""
    return arm.links, [(joint.axis, joint.rotor_inertia, joint.stiffness) for joint in arm.joints]
