"""Settings of an environment: declaration, checks and plain form of each."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np

from flexman_gym.common.checks import finite, one_of, physical, positive, sequence, text, value_error, whole_number
from flexman_gym.control.actions import ACTIONS, ActionMode
from flexman_gym.control.agent import MAX_HISTORY
from flexman_gym.control.base_controllers import BASES, parse_kind
from flexman_gym.control.controller import checked_controller
from flexman_gym.envs.config.randomisation import Randomisation
from flexman_gym.envs.limits import Limits, find_limits
from flexman_gym.envs.sensors import find_sensors, plain_sensors
from flexman_gym.envs.tasks import Task, find_task, plain_task
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import warn_unusual_units
from flexman_gym.scene.serialization import find_arm, to_plain
from flexman_gym.simulation.methods import DEFAULT_METHOD, Method
from flexman_gym.simulation.trajectory import ENERGY_ALARM

CHOSEN = ("elements", "modes", "method", "step", "stiffening")  # settings chosen by fidelity="auto"
MIN_PERIOD, MAX_PERIOD = 1e-9, 100.0  # s; control period
MAX_REPEATS = 1000  # control periods of an action


@dataclass(frozen=True)
class _Setting:
    """Declaration of one setting.

    Attributes:
        help: meaning; tables show the first sentence.
        check: function of the given value that returns the stored value or raises a ValueError.
        default: value of a setting that is not given; None if the named environment defines it.
        unit: SI unit; "" for none.
        named: True if the named environment has the value for None.
        plain: function that returns the plain form of a stored object; None if the stored value is plain.
        deprecated: deprecated names.
        foreign: name in other libraries -> hint in the error message.
    """

    help: str
    check: Callable[[Any], Any]
    default: Any = None
    unit: str = ""
    named: bool = False
    plain: Callable[[Any], Any] | None = None
    deprecated: tuple[str, ...] = ()
    foreign: Mapping[str, str] = field(default_factory=dict)


def _setting(*arguments: Any, **columns: Any) -> Any:
    """Return a declaration; the annotation of the class attribute is the type of the stored value."""
    return _Setting(*arguments, **columns)


def _as_given(value: Any) -> Any:
    """Return a value unchanged; its check depends on other settings."""
    return value


def _tuples(value: Any) -> Any:
    """Return lists as tuples, at every level."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _control_period_setting(value: object) -> float:
    """Return a control period, s."""
    period = positive("control_period", value, "s")
    if not MIN_PERIOD <= period <= MAX_PERIOD:
        raise value_error("control_period", value, f"a number from {MIN_PERIOD:g} to {MAX_PERIOD:g} (s)")
    warn_unusual_units("", {"control_period": period})
    return period


def _reward_setting(value: object) -> Any:
    """Return the weights of reward terms, a reward function, or None."""
    if isinstance(value, dict):
        return {text("a key of reward", name): finite(f"reward.{name}", each) for name, each in value.items()}
    if value is not None and not callable(value):
        raise value_error("reward", value, "None, a mapping of weights of the task's terms, or a function of a View")
    return value


def _base_setting(value: Any) -> Any:
    """Return None, a name or a mapping of BASES as it is, or a Controller."""
    if isinstance(value, str | dict):
        parse_kind("base", value, BASES)
    elif value is not None:
        return checked_controller("base", value, f"None, one of {', '.join(BASES)}, or ")
    return value


def _actions_setting(value: Any) -> Any:
    """Return the name or the mapping of an action mode, or an ActionMode, as it is."""
    if not isinstance(value, ActionMode):
        parse_kind("actions", value, ACTIONS)
    return value


def _bandwidth_setting(value: object) -> float | None:
    """Return a bandwidth, Hz, or None."""
    return None if value is None else physical("drive_bandwidth", value, "Hz")


def _info_keys_setting(value: object) -> tuple[str, ...]:
    """Return names of quantities of a view."""
    return tuple(text(f"info_keys[{i}]", each) for i, each in enumerate(sequence("info_keys", value, "names")))


def _find_randomisation(value: object) -> Randomisation | None:
    """Return a Randomisation from a dict of its arguments, a Randomisation as it is, or None."""
    if isinstance(value, dict):
        return Randomisation(**{text("a key of randomisation", name): each for name, each in value.items()})
    if value is not None and not isinstance(value, Randomisation):
        raise value_error("randomisation", value, "a Randomisation, or a dict of its arguments")
    return value


def _parse_history(value: object) -> int | tuple[float, ...]:
    """Return a number of observations, or time constants (s) of averages as a tuple."""
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
        "Weights of the reward terms, or a reward function. A mapping from terms of the task to factors (1 for a term "
        "without an entry), or a function of a View that returns the reward (b,) and includes failures (view.failed).",
        _reward_setting,
    )
    sensors: tuple[object, ...] = _setting(
        "Sensors of the agent. A name, a mapping with a name at 'kind' and flaws (noise, bias, quantisation, delay, "
        "every, dropped), a Sensor object, or a list of these; envs.sensors has the names.",
        find_sensors, named=True, plain=plain_sensors, foreign={"obs_type": "sensors", "observation": "sensors"},
    )
    history: int | tuple[float, ...] = _setting(
        "Number of recent observations in the input of the agent, the newest first. Or time constants in s: the input "
        "is then the present observation and its exponential averages with these time constants.",
        _parse_history, 1,
    )
    limits: Limits = _setting(
        "Limits of the motion, beyond which an episode ends. A Limits object, or a mapping of its arguments.",
        find_limits, named=True, plain=asdict,
    )
    torque_limit: tuple[float, ...] = _setting(
        "Torque limits of the motors. One number, or one for each joint; None takes those of the joints of the arm.",
        _as_given, unit="N m",
    )
    control_period: float = _setting(
        "Time between two commands to the motors.", _control_period_setting, unit="s", named=True,
        foreign=dict.fromkeys(("dt", "timestep"), "control_period, the time in s between two actions, or step, that "
        "of the integrator"),
    )
    horizon: float = _setting(
        "Time after which an episode is truncated.", partial(positive, "horizon", unit="s"), unit="s", named=True,
        foreign=dict.fromkeys(("max_steps", "max_episode_length"), "horizon, the time in s after which an episode is "
        "truncated"),
    )
    base: Any = _setting(
        "Base controller, to whose torques the agent adds its own. It acts in every control period: a name in "
        "control.BASES, such as 'pd', the PD tuned for the arm of the named environment; a mapping with a name at "
        "'kind' and its arguments; or a Controller. None for none. The sum saturates at the torque limits.",
        _base_setting,
    )
    gains: Any = _setting(
        "Gains of base='pd'. A mapping with stiffness (N m/rad) and damping (N m s/rad), a number for each joint; None "
        "takes the gains tuned for the named environment, an error for an arm with other links or motors.",
        _as_given,
    )
    actions: Any = _setting(
        "Meaning of an action. A name in control.actions.ACTIONS: 'torque' as a fraction of the torque limits, "
        "'current' of the motors, 'position' or 'velocity' of servos, 'shaping' of the reference of the base; or a "
        "mapping with a name at 'kind' and its arguments. A servo runs in every control period: with "
        "control_period=0.002 and action_repeat=10 at 500 Hz under an agent at 50 Hz.",
        _actions_setting, "torque",
    )
    drive_bandwidth: float | None = _setting(
        "Bandwidth of the drives, a first-order lag between command and torque. None for no lag.",
        _bandwidth_setting, unit="Hz",
    )
    action_repeat: int = _setting(
        "Control periods for which the action of the agent is kept. One step of the environment spans them: its reward "
        "is their mean, its info that of the last one; an episode may end before the last one.",
        partial(whole_number, "action_repeat", low=1, high=MAX_REPEATS), 1, deprecated=("hold",),
        foreign={"frame_skip": "action_repeat, the control periods for which an action is kept"},
    )
    fidelity: str = _setting(
        f"Choice of the model. 'auto' chooses {', '.join(CHOSEN)} for a tolerance; 'default' takes them as given.",
        partial(one_of, "fidelity", allowed=("default", "auto")), "default",
    )
    tolerance: float | None = _setting(
        "Largest error of the tip in a slew, for fidelity='auto'.", _as_given, unit="m",
    )
    elements: int | tuple[int, ...] = _setting("Elements of each link, see build_model.", _tuples, 2)
    modes: int | tuple[int | tuple[int, ...], ...] | str | None = _setting(
        "Modes of each link, see build_model. 'assembled': those of assembled_modes below half the control rate.",
        _tuples, "assembled",
    )
    method: str | Method = _setting("Integration method, a name in METHODS or a Method.", _as_given, DEFAULT_METHOD)
    step: float | None = _setting(
        "Step of the integration method. None takes the longest one that divides the control period, up to the longest "
        "step of the named environment.",
        _as_given, unit="s",
    )
    stiffening: bool = _setting("Foreshortening of bent links, see build_model.", _as_given, False)
    spinning_rotors: bool = _setting("Rotation of rotors with their links, see ModelChoice.", _as_given, False)
    rotary_inertia: bool = _setting("Rotary inertia of the sections of links, see ModelChoice.", _as_given, True)
    info_keys: tuple[str, ...] = _setting(
        "Additional quantities in info. Names in View.units; 'action' is the command to the motors.",
        _info_keys_setting, (), deprecated=("tell",),
    )
    energy_alarm: float = _setting(
        "Energy residual that raises the alarm, as a fraction of the energy turnover. The turnover is the largest of "
        "kinetic + elastic energy, work and dissipation.",
        partial(positive, "energy_alarm"), ENERGY_ALARM,
    )
    randomisation: Randomisation | None = _setting(
        "Ranges of parameters and disturbances, drawn in each episode. A Randomisation, or a mapping of its arguments.",
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
"""Declared settings of an environment: name -> _Setting."""
