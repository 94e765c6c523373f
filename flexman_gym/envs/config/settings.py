"""Settings of an environment: declaration, checks and JSON-compatible data of each setting."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from flexman_gym.agent.action_modes import ACTIONS, ActionMode
from flexman_gym.agent.agent import MAX_HISTORY
from flexman_gym.agent.base_controllers import BASES, parse_kind
from flexman_gym.agent.controller import checked_controller
from flexman_gym.common.checks import finite, flag, one_of, physical, positive, sequence, text, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.randomisation import Randomisation
from flexman_gym.envs.foundation import find_foundation, plain_foundation
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.sensors import find_sensors, plain_sensors
from flexman_gym.envs.tasks import Task, find_task, plain_task
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import warn_unusual_units
from flexman_gym.scene.serialization import find_arm, to_plain
from flexman_gym.simulation.methods import DEFAULT_METHOD, METHODS, Method
from flexman_gym.simulation.trajectory import ENERGY_ALARM

AUTO_SETTINGS = ("elements", "modes", "method", "step", "stiffening")  # settings chosen by fidelity="auto"
MIN_PERIOD, MAX_PERIOD = 1e-9, 100.0  # s; range of the control period
MAX_REPEATS = 1000  # largest action_repeat


@dataclass(frozen=True)
class _Setting:
    """Declaration of one setting.

    Attributes:
        help: description; tables show its first sentence.
        check: function that returns the stored value for a given value, or raises ValueError.
        default: value of a missing setting; None if the named environment defines it.
        unit: SI unit; "" for a setting without a unit.
        named: True if None stands for the value of the named environment.
        plain: function that returns the JSON-compatible data of a stored object; None if the stored value is
            JSON-compatible.
        foreign: name of this setting in other libraries -> hint in the error message.
    """

    help: str
    check: Callable[[Any], Any]
    default: Any = None
    unit: str = ""
    named: bool = False
    plain: Callable[[Any], Any] | None = None
    foreign: Mapping[str, str] = field(default_factory=dict)


def _setting(*arguments: Any, **columns: Any) -> Any:
    """Return a _Setting; the result type Any allows to annotate a class attribute with the type of the stored value."""
    return _Setting(*arguments, **columns)


def _as_given(value: Any) -> Any:
    """Return a value unchanged; `Configuration` checks it together with other settings."""
    return value


def _method(value: Any) -> str | Method:
    """Return an integration method, or its name if METHODS contains it."""
    return value if isinstance(value, Method) else one_of("method", value, METHODS)


def _tuples(value: Any) -> Any:
    """Return a value with all lists, also nested ones, replaced by tuples."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _control_period_setting(value: object) -> float:
    """Return a control period, s, after a check."""
    period = positive("control_period", value, "s")
    if not MIN_PERIOD <= period <= MAX_PERIOD:
        raise value_error("control_period", value, f"a number from {MIN_PERIOD:g} to {MAX_PERIOD:g} (s)")
    warn_unusual_units("", {"control_period": period})
    return period


def _reward_setting(value: object) -> Any:
    """Return the weights of reward terms, a reward function, or None, after a check."""
    if isinstance(value, dict):
        return {text("a key of reward", name): finite(f"reward.{name}", each) for name, each in value.items()}
    if value is not None and not callable(value):
        raise value_error("reward", value, "None, a mapping of weights of the task's terms, or a function of a View")
    return value


def _base_setting(value: Any) -> Any:
    """Return a name or a mapping of BASES, a Controller, or None, after a check."""
    if isinstance(value, str | dict):
        parse_kind("base", value, BASES)
    elif value is not None:
        return checked_controller("base", value, f"None, one of {', '.join(BASES)}, or ")
    return value


def _info_keys_setting(value: object) -> tuple[str, ...]:
    """Return names of quantities as a tuple."""
    return tuple(text(f"info_keys[{i}]", each) for i, each in enumerate(sequence("info_keys", value, "names")))


def _actions_setting(value: Any) -> Any:
    """Return the name or the mapping of an action mode, or an ActionMode, after a check."""
    if not isinstance(value, ActionMode):
        parse_kind("actions", value, ACTIONS)
    return value


def _find_randomisation(value: object) -> Randomisation | None:
    """Convert a dict of arguments to a Randomisation; a Randomisation and None are returned unchanged."""
    if isinstance(value, dict):
        return Randomisation(**{text("a key of randomisation", name): each for name, each in value.items()})
    if value is not None and not isinstance(value, Randomisation):
        raise value_error("randomisation", value, "a Randomisation, or a dict of its arguments")
    return value


def _parse_history(value: object) -> int | tuple[float, ...]:
    """Return a number of observations, or a tuple of time constants (s) of averages."""
    if not isinstance(value, list | tuple) and not (isinstance(value, np.ndarray) and value.ndim):
        return whole_number("history", value, 1, MAX_HISTORY)
    times = sequence("history", value, "times (s)")
    if not 0 < len(times) <= MAX_HISTORY:
        raise value_error("history", value, f"a whole number, or 1 to {MAX_HISTORY} times (s)")
    return tuple(positive(f"history[{i}]", time, "s") for i, time in enumerate(times))


class EnvironmentSettings:
    """Settings of an environment, declared as class attributes; an instance stores their checked values."""

    # fmt: off
    arm: Arm = _setting(
        "Robot arm. An Arm, the name of an arm of the catalog, a mapping with that name at 'catalog' and its "
        "arguments, the path of a file with an arm or a scene, or a mapping with the content of such a file.",
        find_arm, named=True, plain=to_plain, foreign={
            "gravity": "it to the arm, as gravity belongs to it: arm=fm.Arm(..., gravity=(0, 0, -9.81)), or "
            'arm={"catalog": "planar_2r", "gravity": [0, 0, -9.81]}',
            "payload": "it to the arm, which carries it: arm=fm.Arm(..., payload=fm.Payload(0.5))",
            "damping": "it to the arm, whose links and joints are damped: arm=fm.Arm(..., modal_damping_ratio=0.01)",
        },
    )
    task: Task = _setting(
        "Task. An object such as Slew(), its name 'slew', or a mapping with the name at 'kind' and its arguments.",
        find_task, named=True, plain=plain_task,
    )
    reward: Any = _setting(
        "Name of a reward of the task (slews: 'bells', 'distance', which trains better, 'exponential'), weights of its "
        "terms, or a reward function. Weights are a mapping from terms to factors (1 for a term without an entry); a "
        "function of a View returns the reward (b,) and includes failures (view.failed).",
        _reward_setting,
    )
    sensors: tuple[object, ...] = _setting(
        "Sensors of the agent. A name in envs.sensors.SENSOR_NAMES, a mapping with a name at 'kind' and flaws (noise, "
        "bias, quantisation, delay, every, dropped), a Sensor object, or a list of these.",
        find_sensors, named=True, plain=plain_sensors, foreign={"obs_type": "sensors", "observation": "sensors"},
    )
    history: int | tuple[float, ...] = _setting(
        "Number of recent observations in the input of the agent, the newest first. Or time constants in s: the input "
        "is then the present observation and its exponential averages with these time constants.",
        _parse_history, 1,
    )
    limits: Limits = _setting(
        "Limits of the motion, beyond which an episode terminates or has a cost. A Limits object, a mapping of its "
        "arguments, or 'study': strains and spring torques that half of the slews of the LQR exceed, with a cost.",
        Limits.find, named=True, plain=Limits.to_plain,
    )
    torque_limit: tuple[float, ...] = _setting(
        "Torque limits of the motors. One number, or one for each joint; None for those in the joints of the arm.",
        _as_given, unit="N m",
    )
    control_period: float = _setting(
        "Time between two commands to the motors.", _control_period_setting, unit="s", named=True,
        foreign=dict.fromkeys(("dt", "timestep"), "control_period, the time in s between two actions, or step, that "
        "of the integrator"),
    )
    settings: str = _setting(
        "Source of control period, horizon, limits and slew time that are not given, for an arm whose links or joints "
        "differ from those of the named environment. 'arm': they follow from the modes, rotors, motors and slews of "
        "the arm, see describe; 'named': those of the named environment.",
        partial(one_of, "settings", allowed=("arm", "named")), "arm",
    )
    horizon: float = _setting(
        "Time after which an episode is truncated.", partial(positive, "horizon", unit="s"), unit="s", named=True,
        foreign=dict.fromkeys(("max_steps", "max_episode_length"), "horizon, the time in s after which an episode is "
        "truncated"),
    )
    slew_time: float = _setting(
        "Time of a usual slew, to which the distance reward of the tasks relates velocities.",
        partial(positive, "slew_time", unit="s"), unit="s", named=True,
    )
    base: Any = _setting(
        "Base controller, to whose torques the agent adds its own. It acts in every control period: a name in "
        "control.BASES, such as 'pd', the PD tuned for the arm of the named environment; a mapping with a name at "
        "'kind' and its arguments; or a Controller. None for none. The sum saturates at the torque limits.",
        _base_setting,
    )
    gains: Any = _setting(
        "Gains of base='pd'. A mapping with stiffness (N m/rad) and damping (N m s/rad), a number for each joint. None "
        "stands for the gains tuned for the named environment, and for designed ones of an arm with different links or "
        "motors.",
        _as_given,
    )
    actions: Any = _setting(
        "Meaning of an action. A name in agent.action_modes.ACTIONS: 'torque', motor torques as fractions of the "
        "torque limits; 'current' or 'voltage', motor currents or voltages; 'position' or 'velocity', references of "
        "servos; 'shaping', changes of the reference of the base controller; or a mapping with a name at 'kind' and "
        "its arguments. A servo acts in every control period: with control_period=0.002 and action_repeat=10 at 500 "
        "Hz, below an agent at 50 Hz.",
        _actions_setting, named=True,
    )
    foundation: Any = _setting(
        "Motion of the foundation. A mapping with 'travel' at 'kind', which the agent commands, and axis, speed (m/s), "
        "acceleration (m/s^2) and travel (m, the distance of the stops from the middle); with 'sea', a deck in a "
        "seaway, and its period (s) and significant amplitudes: surge, sway, heave (m), roll, pitch, yaw (rad); or "
        "with 'record', and the path of a CSV file with such columns at 'file'. None for a fixed foundation.",
        find_foundation, named=True, plain=plain_foundation,
    )
    clip_actions: bool = _setting(
        "True to clip actions beyond the range from -1 to 1; False to refuse them with an error. NaN and infinite "
        "actions are always refused.",
        partial(flag, "clip_actions"), False, foreign={"clip_action": "clip_actions"},
    )
    drive_bandwidth: float | None = _setting(
        "Bandwidth of the drives, a first-order lag between commanded and applied torque. None for no lag.",
        lambda value: None if value is None else physical("drive_bandwidth", value, "Hz"), unit="Hz",
    )
    action_repeat: int = _setting(
        "Number of control periods for which an action of the agent is held. A step of the environment simulates them, "
        "returns the mean of their rewards and the info of the last one, and stops early if the episode ends.",
        partial(whole_number, "action_repeat", low=1, high=MAX_REPEATS), 1,
        foreign=dict.fromkeys(("frame_skip", "frameskip"), "action_repeat, the number of control periods for which an "
        "action is held"),
    )
    safety: bool = _setting(
        "True to change the torques of the agent, as little as possible, so that the arm can always be stopped within "
        "its limits, see control.safety. The filter uses the estimator of the base controller or, for sensors of a "
        "laboratory, its own; otherwise the true state. It needs the extra mpc.",
        partial(flag, "safety"), False,
    )
    fidelity: str = _setting(
        f"Selection of the model. 'auto' chooses {', '.join(AUTO_SETTINGS)} for a tolerance; 'default' uses these "
        "settings.",
        partial(one_of, "fidelity", allowed=("default", "auto")), "default",
    )
    tolerance: float | None = _setting(
        "Largest tip error of the model in a slew, for fidelity='auto'.", _as_given, unit="m",
    )
    elements: int | tuple[int, ...] = _setting("Number of beam elements of each link, see build_model.", _tuples, 2)
    modes: int | tuple[int | tuple[int, ...], ...] | str | None = _setting(
        "Component modes of each link, see build_model. 'assembled': those that vibrations of the arm below half the "
        "control rate need, see assembled_modes.",
        _tuples, "assembled",
    )
    method: str | Method = _setting("Integration method, a name in METHODS or a Method.", _method, DEFAULT_METHOD)
    step: float | None = _setting(
        "Step of the integration method. None stands for the longest divisor of the control period up to the longest "
        "step of the named environment.",
        _as_given, unit="s",
    )
    stiffening: bool = _setting("Foreshortening of deformed links, see build_model.", _as_given, False)
    spinning_rotors: bool = _setting("Rotation of rotors with their links, see ModelChoice.", _as_given, False)
    rotary_inertia: bool = _setting("Rotary inertia of the cross-sections, see ModelChoice.", _as_given, True)
    info_keys: tuple[str, ...] = _setting(
        "Additional quantities in info. Names in View.units, or 'action' for the commanded torques.",
        _info_keys_setting, (),
    )
    energy_alarm: float = _setting(
        "Energy residual above which info['energy_alarm'] is True, as a fraction of the energy turnover. The turnover "
        "is the largest of kinetic + elastic energy, work and dissipation since the reset.",
        partial(positive, "energy_alarm"), ENERGY_ALARM,
    )
    randomisation: Randomisation | None = _setting(
        "Ranges from which each episode draws parameters and disturbances. A Randomisation, or a mapping of its "
        "arguments.",
        _find_randomisation, plain=lambda value: {name: getattr(value, name) for name in value.given}, foreign={
            "delay": 'randomisation={"delay": (1, 1)}, the smallest and the largest delay of the torques in control '
            "periods",
            "noise": 'randomisation={"sensor_noise": ...}, or sensors with flaws',
            "seed": "it to reset(seed=...)",
        },
    )
    # fmt: on


SETTINGS: dict[str, _Setting] = {
    name: each for name, each in vars(EnvironmentSettings).items() if isinstance(each, _Setting)
}
"""Settings of an environment: name -> declaration."""
