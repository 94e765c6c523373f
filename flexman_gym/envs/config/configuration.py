"""Configuration of an environment: its settings, declared once, checked once and handed on."""

import os
import sys
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, Self

from flexman_gym.common import files
from flexman_gym.common.checks import (
    mapping,
    one_of,
    positive,
    sequence,
    short_path,
    text,
    value_error,
    vector,
    whole_number,
)
from flexman_gym.common.renamed import deprecated_names
from flexman_gym.control.agent import parse_history
from flexman_gym.control.margins import first_order_lag
from flexman_gym.control.pd import torque_limits
from flexman_gym.envs.config import settings as checks
from flexman_gym.envs.config.named_environments import (
    DEFAULT_ID,
    NAMED_ENVIRONMENTS,
    NOMINAL,
    Gains,
    condition_settings,
)
from flexman_gym.envs.config.randomisation import Randomisation, find_randomisation
from flexman_gym.envs.config.settings import Setting, is_plain, links_and_motors, lists, put
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors import find_sensors, plain_sensors
from flexman_gym.envs.tasks import Task, plain_task
from flexman_gym.envs.tasks.rewards import checked_reward
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import warn_unusual_units
from flexman_gym.scene.serialization import SUFFIXES, find_arm, to_plain
from flexman_gym.simulation.methods import DEFAULT_METHOD, Method
from flexman_gym.simulation.trajectory import ENERGY_ALARM

CHOSEN = ("elements", "modes", "method", "step", "stiffening")  # settings that fidelity="auto" chooses
PARTS = ("arm", "task", "limits")  # settings of a named environment of which a change may name a part
LIBRARIES = ("flexman_gym", "flexman_agents", "gymnasium")  # packages between a user and a configuration
MOST_REPEATS, MOST_PERIODS = 1000, 10**9  # control periods; of an action, of an episode


def _setting(*arguments: Any, **columns: Any) -> Any:
    """Declare a setting; the annotation of the class attribute is the type of the stored value."""
    return Setting(*arguments, **columns)


class Configuration:
    """Configuration of an environment: an id and settings, checked when it is made.

    A setting that is not given has its default, or the value of the named environment. Settings may be plain data
    (texts, numbers, booleans, lists, mappings) or objects; a file holds plain data only. The setting "condition" names
    a condition of the environment, which changes the settings that are not given.

    Args:
        id: of a named environment.
        settings: name -> value, as in `gym.make`.
        folder: to which the path of a file with an arm is relative.

    Raises:
        ValueError: one line with field, value, unit and what is allowed; for an unknown name with the nearest one.
    """

    id: str
    _given: dict[str, Any]
    # fmt: off
    arm: Arm = _setting(
        "Arm. An Arm, the name of a function of the catalog, a mapping with that name at 'catalog' and its arguments, "
        "the path of a file with an arm or a scene, or a mapping as in such a file.",
        find_arm, named=True, plain=to_plain, elsewhere={
            "gravity": "it to the arm, as gravity belongs to it: arm=fm.Arm(..., gravity=(0, 0, -9.81)), or "
            'arm={"catalog": "planar_2r", "gravity": [0, 0, -9.81]}',
            "payload": "it to the arm, which carries it: arm=fm.Arm(..., payload=fm.Payload(0.5))",
            "damping": "it to the arm, whose links and joints are damped: arm=fm.Arm(..., modal_damping_ratio=0.01)",
        },
    )
    task: Task = _setting(
        "Task. An object such as Slew(), its name 'slew', or a mapping with the name at 'kind' and its arguments.",
        checks.checked_task, named=True, plain=plain_task,
    )
    reward: Any = _setting(
        "Weights of the reward terms, or a reward function. A mapping from terms of the task to factors, 1 for a term "
        "without an entry; or a function that returns the reward (b,) of a View, failures (view.failed) included.",
        checked_reward,
    )
    sensors: tuple[object, ...] = _setting(
        "Sensors of the agent. A name, a mapping with a name at 'kind' and flaws (noise, bias, quantisation, delay, "
        "every, dropped), a Sensor object, or a list of these; envs.sensors has the names.",
        find_sensors, named=True, plain=plain_sensors, elsewhere={"obs_type": "sensors", "observation": "sensors"},
    )
    history: int | tuple[float, ...] = _setting(
        "Number of observations that the agent sees, the newest first. Or time constants in s: the agent then sees the "
        "present observation and its exponential averages with these time constants.",
        parse_history, 1,
    )
    limits: Limits = _setting(
        "Limits of the motion, beyond which an episode ends. A Limits, or a mapping of its arguments.",
        checks.checked_limits, named=True, plain=asdict,
    )
    torque_limit: tuple[float, ...] = _setting(
        "Torque limits of the motors. One number, or one for each joint; None takes those of the joints of the arm.",
        checks.keep, unit="N m",
    )
    control_period: float = _setting(
        "Time between two commands to the motors.", checks.checked_period, unit="s", named=True,
        elsewhere=dict.fromkeys(("dt", "timestep"), "control_period, the time in s between two actions, or step, that "
        "of the integrator"),
    )
    horizon: float = _setting(
        "Time after which an episode is truncated.", partial(positive, "horizon", unit="s"), unit="s", named=True,
        elsewhere=dict.fromkeys(("max_steps", "max_episode_length"), "horizon, the time in s after which an episode is "
        "truncated"),
    )
    base: Any = _setting(
        "Base controller, to whose torques the agent adds its own. It acts in every control period: a name in "
        "control.BASES, such as 'pd', the PD tuned for the arm of the named environment; a mapping with a name at "
        "'kind' and its arguments; or a Controller. None for none. The sum saturates at the torque limits.",
        checks.checked_base_setting,
    )
    gains: Any = _setting(
        "Gains of base='pd'. A mapping with stiffness (N m/rad) and damping (N m s/rad), a number for each joint; None "
        "takes the gains tuned for the named environment, which suit no arm with other links or motors.",
        checks.keep,
    )
    actions: Any = _setting(
        "Meaning of an action. A name in control.actions.ACTIONS: 'torque' as a part of the torque limits, 'current' "
        "of the motors, 'position' or 'velocity' of servos, 'shaping' of the reference of the base; or a mapping with "
        "a name at 'kind' and its arguments. A servo runs in every control period: with control_period=0.002 and "
        "action_repeat=10 at 500 Hz under an agent at 50 Hz.",
        checks.checked_actions, "torque",
    )
    drive_bandwidth: float | None = _setting(
        "Bandwidth of the drives, a first-order lag between command and torque. None for no lag.",
        checks.checked_bandwidth, unit="Hz",
    )
    action_repeat: int = _setting(
        "Control periods for which the action of the agent is kept. A step of the environment spans them: its reward "
        "is their mean, its info that of the last one; an episode may end before the last one.",
        partial(whole_number, "action_repeat", low=1, high=MOST_REPEATS), 1, formerly=("hold",),
        elsewhere={"frame_skip": "action_repeat, the control periods for which an action is kept"},
    )
    fidelity: str = _setting(
        f"Choice of the model. 'auto' chooses {', '.join(CHOSEN)} for a tolerance; 'default' takes them as given.",
        partial(one_of, "fidelity", allowed=("default", "auto")), "default",
    )
    tolerance: float | None = _setting("Largest error of the tip in a slew, of fidelity='auto'.", checks.keep, unit="m")
    elements: int | tuple[int, ...] = _setting("Elements of each link, see build_model.", checks.tuples, 2)
    modes: int | tuple[int | tuple[int, ...], ...] | str | None = _setting(
        "Modes of each link, see build_model. 'assembled': those of assembled_modes below half the control rate.",
        checks.tuples, "assembled",
    )
    method: str | Method = _setting("Integration method, a name in METHODS or a Method.", checks.keep, DEFAULT_METHOD)
    step: float | None = _setting(
        "Step of the integration method. None takes the longest one that divides the control period, up to the longest "
        "step of the named environment.",
        checks.keep, unit="s",
    )
    stiffening: bool = _setting("Foreshortening of bent links, see build_model.", checks.keep, False)
    spinning_rotors: bool = _setting("Rotation of rotors with their links, see ModelChoice.", checks.keep, False)
    rotary_inertia: bool = _setting("Rotary inertia of the sections of links, see ModelChoice.", checks.keep, True)
    tell: tuple[str, ...] = _setting(
        "Quantities that info also holds. Names in View.units; 'action' is the command to the motors.",
        checks.checked_names, (),
    )
    energy_alarm: float = _setting(
        "Energy residual that raises the alarm, as a part of the energy turnover. The turnover is the largest of "
        "kinetic + elastic energy, work and dissipation.",
        partial(positive, "energy_alarm"), ENERGY_ALARM,
    )
    randomisation: Randomisation | None = _setting(
        "Ranges of parameters and disturbances, drawn in each episode. A Randomisation, or a mapping of its arguments.",
        find_randomisation, plain=lambda value: {name: getattr(value, name) for name in value.given}, elsewhere={
            "delay": 'randomisation={"delay": (1, 1)}, the fewest and the most control periods by which torques come '
            "late",
            "noise": 'randomisation={"sensor_noise": ...}, or sensors with flaws',
            "seed": "it to reset(seed=...)",
        },
    )
    # fmt: on

    def __init__(self, id: str = DEFAULT_ID, settings: Mapping[str, Any] | None = None, folder: Path = Path()) -> None:
        named, given = NAMED_ENVIRONMENTS[one_of("id", id, NAMED_ENVIRONMENTS)], dict(settings or {})
        if given.pop("condition", NOMINAL) != NOMINAL:
            given = {**condition_settings(id, settings["condition"]), **given}  # type: ignore[index]
        given = _present(given, True)
        _refuse_unknown(given)
        if isinstance(given.get("arm"), str) and given["arm"].endswith(SUFFIXES):
            given["arm"] = to_plain(find_arm(given["arm"], folder))
        vars(self).update(id=id, _given=given)
        for name, setting in SETTINGS.items():
            value = given.get(name, setting.default)
            vars(self)[name] = setting.check(named.value(name) if value is None and setting.named else value)
        self._check_together()

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"{name}: a configuration is not changed; make another one with replace")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Configuration):
            return NotImplemented
        one, two = (lists(each.to_plain(strict=False)) for each in (self, other))
        return bool(one == two)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Configuration({self.id!r}, {self._given!r})"

    def _check_together(self) -> None:
        """Check the settings that depend on others, and store what follows from them."""
        vars(self)["torque_limit"] = self._torque_limits()
        if not 0.5 <= self.horizon / self.control_period <= MOST_PERIODS:
            allowed = f"1 to {MOST_PERIODS} control periods of {self.control_period} s"
            raise value_error("horizon", self.horizon, allowed)
        warn_unusual_units("", {"horizon": self.horizon})
        if self.base == "pd":
            vars(self)["gains"] = self.pd_gains
        if self.fidelity == "default":
            if self.tolerance is not None:
                raise value_error("tolerance", self.tolerance, 'None without fidelity="auto"')
            if isinstance(self.modes, str):
                one_of("modes", self.modes, ("assembled",))
            return
        for name in CHOSEN:
            if getattr(self, name) != SETTINGS[name].default:
                raise value_error(name, getattr(self, name), 'nothing: fidelity="auto" chooses it')
        positive("tolerance", self.tolerance, 'm, for fidelity="auto"')

    def _torque_limits(self) -> tuple[float, ...]:
        """Return the torque limits that were given, else those of the joints, N m."""
        given: Any = self.torque_limit
        arm, own = self.arm, [joint.torque_limit for joint in self.arm.joints]
        if given is not None:
            return torque_limits("torque_limit", given, arm.n_joints)
        if None in own:
            allowed = "one number (N m), or one for each joint: the joints of this arm have no torque_limit"
            raise value_error("torque_limit", None, allowed)
        return torque_limits("torque_limit", own, arm.n_joints)

    @classmethod
    def from_keywords(cls, keywords: Mapping[str, Any], others: Collection[str] = ()) -> "Configuration":
        """Return the configuration of keyword arguments of `gym.make` and `gym.make_vec`.

        Args:
            keywords: settings, "name", the id of a named environment, and "configuration", a Configuration in which
                they change some settings.
            others: names of keyword arguments of an environment that are no settings, for the error.

        Raises:
            ValueError: see the class.
        """
        given = dict(keywords)
        whole = given.pop("configuration", None)
        if whole is not None and not isinstance(whole, Configuration):
            raise value_error("configuration", whole, "a Configuration")
        id = one_of("name", given.pop("name", whole.id if whole else DEFAULT_ID), NAMED_ENVIRONMENTS)
        _refuse_unknown(given, ("condition", *others))
        if whole is None:
            return cls(id, given)
        if whole.id != id:
            raise value_error("configuration", whole.id, f"one of {id}")
        return whole.replace(**given)

    @classmethod
    def from_plain(cls, data: object, folder: Path = Path(), warn: bool = False) -> Self:
        """Return the configuration in a mapping with "id" and settings.

        Args:
            data: the mapping.
            folder: to which the path of a file with an arm is relative.
            warn: warn of deprecated names; files of earlier versions have them.
        """
        settings = _present(data, warn)
        return cls(settings.pop("id", DEFAULT_ID), settings, folder)

    @classmethod
    def load(cls, path: str | Path, changes: Sequence[str] = ()) -> Self:
        """Read a .json, .yaml or .yml file: a mapping with "id" and settings; see `find` for the changes.

        Raises:
            FileNotFoundError: when there is none.
            ValueError: one line with file, field, value and what is allowed.
        """
        try:
            return cls._with_changes(files.read_data(Path(path)), changes, Path(path).parent, warn=True)
        except ValueError as error:
            raise ValueError(f"{short_path(path)}: {error}") from None

    @classmethod
    def find(cls, name: "str | Configuration", changes: Sequence[str] = ()) -> Self:
        """Return a named environment, one under a condition such as "FlexRRR-v0/unknown", or that of a file.

        Args:
            name: an id, an id and a condition, the path of a file, or a Configuration.
            changes: "name=value", see `changed`.

        Raises:
            FileNotFoundError, ValueError: one line, also where it is none of them.
        """
        if isinstance(name, Configuration):
            return name.changed(changes) if changes else name  # type: ignore[return-value]
        id, slash, condition = text("environment", name).partition("/")
        if id in NAMED_ENVIRONMENTS and (slash or name in NAMED_ENVIRONMENTS):
            settings = condition_settings(id, condition) if slash else {}
            return cls._with_changes({"id": id, **settings}, changes)
        if not os.path.exists(name):  # whatever the name is
            allowed = f"one, or one of {', '.join(sorted(NAMED_ENVIRONMENTS))}"
            raise FileNotFoundError(f"{short_path(name)}: there is no such file; give {allowed}")
        return cls.load(name, changes)

    @property
    def settings(self) -> dict[str, Any]:
        """A copy of the settings that were given, with those of the condition in its place."""
        return dict(self._given)

    def keywords(self) -> dict[str, Any]:
        """Return keyword arguments of `gym.make` and `gym.make_vec`, which do not parse the settings anew."""
        return {"configuration": self}

    def replace(self, **changes: Any) -> "Configuration":
        """Return the same configuration with settings changed; itself without changes."""
        return type(self)(self.id, {**self._given, **changes}) if changes else self

    def without(self, names: Collection[str]) -> "Configuration":
        """Return the same configuration without the settings of these names."""
        kept = {name: value for name, value in self._given.items() if name not in names}
        return self if len(kept) == len(self._given) else type(self)(self.id, kept)

    def to_plain(self, strict: bool = True) -> dict[str, Any]:
        """Return the mapping from which `from_plain` makes the same environment anywhere and later.

        It has the whole arm in place of a name or a file, and the gains of base="pd".

        Args:
            strict: refuse an object without a plain form; else it stays in the mapping.

        Raises:
            ValueError: for a task, sensors, a controller or a function of the user, which no file can hold.
        """
        plain = {name: self._plain(name, value, strict) for name, value in self._given.items()}
        if self.base == "pd":
            plain["gains"] = {name: list(numbers) for name, numbers in self.gains.items()}
        return {"id": self.id, **plain, "arm": to_plain(self.arm)}

    def _plain(self, name: str, value: Any, strict: bool) -> Any:
        """Return the plain form of a setting that was given as a value."""
        if is_plain(value):
            return value
        stored, form = getattr(self, name), SETTINGS[name].plain
        try:
            if form is None and not is_plain(stored):
                raise value_error(
                    name, stored, "something with a name: an object of one's own cannot be kept in a file"
                )
            return form(stored) if form and stored is not None else stored
        except ValueError:
            if strict:
                raise
            return value

    def save(self, path: str | Path) -> None:
        """Write the whole environment to a .json, .yaml or .yml file, from which `load` makes an equal one.

        The commands take such a file: `flexman train --env FILE`.

        Raises:
            ValueError: for another suffix, and for an object without a plain form.
        """
        files.write_data(Path(path), lists(self.to_plain()))

    def changed(self, changes: Sequence[str]) -> "Configuration":
        """Return the same configuration with changes "name=value".

        Values are as in a file; names with dots lead into mappings, the arm, the task and the limits. The parts that
        a change does not name stay as they are.

        Raises:
            ValueError: one line with the change and what is allowed.
        """
        return self._with_changes({"id": self.id, **self._given}, changes) if changes else self

    @classmethod
    def _with_changes(cls, data: object, changes: Sequence[str], folder: Path = Path(), warn: bool = False) -> Self:
        """Return the configuration of a mapping with changes; it is checked after the last one."""
        data = _present(data, warn)
        for change in sequence("--set", changes, "texts"):
            name, equals, written = text("--set", change).partition("=")
            if not equals or not all(part.isidentifier() for part in name.split(".")):
                raise value_error("--set", change, "name=value, such as control_period=0.01 or arm.payload.mass=0.5")
            try:
                value = files.parse_yaml(written)
            except (ValueError, RecursionError):
                raise value_error(
                    "--set", change, "a value that is a number, a text, [a, list] or {a: mapping}"
                ) from None
            first, *rest = name.split(".")
            first = current_name(first)
            if name == "condition":  # replaces earlier settings of the same names
                data |= condition_settings(data["id"], value)
                continue
            if rest and first in PARTS:
                named, form = NAMED_ENVIRONMENTS[one_of("id", data["id"], NAMED_ENVIRONMENTS)], SETTINGS[first]
                given = find_arm(data["arm"], folder) if first == "arm" and first in data else data.get(first)
                assert form.plain is not None
                data[first] = form.plain(form.check(given)) if first in data else named.plain(first)
            put(data, [first, *rest], value)
        return cls.from_plain(data, folder)

    @property
    def disturbed(self) -> Randomisation | None:
        """The randomisation together with the disturbances of the task, of which the former overrides the latter."""
        task, own = dict(getattr(self.task, "disturbances", {})), self.randomisation
        if not task:
            return own
        return Randomisation(**task | (own.given if own else {}))

    @property
    def latest_delay(self) -> int:
        """Largest delay of the torques, control periods."""
        delay = self.disturbed.delay if self.disturbed else None
        return int(delay[1]) if delay else 0

    @property
    def lag(self) -> tuple[float, float] | None:
        """Lag of the drives in one control period, see `control.margins.first_order_lag`; None for none."""
        return None if self.drive_bandwidth is None else first_order_lag(self.control_period, self.drive_bandwidth)

    @property
    def longest(self) -> int:
        """Control periods after which an episode is truncated."""
        return max(1, round(self.horizon / self.control_period))

    @property
    def pd_gains(self) -> Gains:
        """The `gains`, or those tuned for the arm of the named environment.

        Raises:
            ValueError: for an arm with other links or motors; payload and friction make no difference.
        """
        named, gains = NAMED_ENVIRONMENTS[self.id], self.gains
        if gains is None:
            if links_and_motors(self.arm) != links_and_motors(named.arm()):
                allowed = f"those of this arm, which flexman tune finds: {self.id} has other links or motors"
                raise value_error("gains", None, allowed)
            return dict(named.pd)
        gains = mapping("gains", gains, ("stiffness", "damping"))
        if len(gains) < 2:
            raise value_error("gains", gains, "a mapping with stiffness (N m/rad) and damping (N m s/rad)")
        return {name: vector(f"gains.{name}", each, self.arm.n_joints) for name, each in gains.items()}


SETTINGS: dict[str, Setting] = {name: each for name, each in vars(Configuration).items() if isinstance(each, Setting)}
"""Declared settings of an environment: name -> Setting."""
_LINES = (f"        {name}: {each.help}" + f" ({each.unit})" * bool(each.unit) for name, each in SETTINGS.items())
Configuration.__doc__ = "\n".join([f"{Configuration.__doc__}\n    Attributes:", *_LINES])
RENAMED = {old: name for name, setting in SETTINGS.items() for old in setting.formerly}
SET_HELP = f"a setting of the environment: {', '.join(SETTINGS)}; arm.payload.mass=0.5 changes a part"
HINTS = {foreign: hint for setting in SETTINGS.values() for foreign, hint in setting.elsewhere.items()}


def current_name(name: str, warn: bool = True) -> str:
    """Return the present name of a setting; a deprecated one is warned of, at the caller outside of the libraries."""
    if name in RENAMED and warn:
        level, frame = 1, sys._getframe()
        while frame.f_back and frame.f_globals["__name__"].partition(".")[0] in LIBRARIES:
            level, frame = level + 1, frame.f_back
        warnings.warn(f"{name} is deprecated; give {RENAMED[name]}", DeprecationWarning, stacklevel=level)
    return RENAMED.get(name, name)


def _present(data: object, warn: bool) -> dict[str, Any]:
    """Return a mapping with "id" and settings under their present names."""
    if not isinstance(data, dict):
        raise value_error("environment", data, "a mapping with id and settings")
    for name, value in data.items():
        if text("a key of environment", name) == "name":
            raise value_error(name, value, "it as id")
        if current_name(name, False) != name and current_name(name, False) in data:
            raise value_error(name, value, f"{current_name(name, False)} only, its present name")
    return {current_name(name, warn): value for name, value in data.items()}


def _refuse_unknown(settings: Mapping[str, Any], others: Collection[str] = ()) -> None:
    """Refuse an unknown setting, with its name here, or the nearest one."""
    known = {*SETTINGS, *RENAMED, "condition", *others}
    for name, value in settings.items():
        if name not in known:
            near = current_name(get_close_matches(name, sorted(known), 1, 0.0)[0], False)
            allowed = f"a known setting: the nearest is {near}; all: {' '.join(sorted([*SETTINGS, *others]))}"
            raise value_error(name, value, HINTS.get(name, allowed))


__getattr__ = deprecated_names(__name__)
