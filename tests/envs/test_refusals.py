"""Tests of refused settings: environments, tasks, sensors and files name field, value and allowed values."""

from dataclasses import fields

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.pd import PD
from flexman_gym.common import files
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.settings import SETTINGS as DECLARED
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.sensors import Quantities, find_sensors
from flexman_gym.envs.tasks import Hold, Slew, Track
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.assertions import refusal

PLANAR, RIGID_JOINT = fm.catalog.planar_2r(), {"arm": fm.catalog.one_link(joint_stiffness=None), "torque_limit": 0.5}
BOTH_KINDS = "task: <class 'flexman_gym.envs.tasks.slew.Slew'> is not allowed; give one of slew"


class Nosy(PD):
    """Controller with sensors that there are not."""

    sensors = ("nose",)


def numbers(kind, allowed, *names):
    """Return the rows of fields of one kind that refuse numbers outside their range."""
    return [({name: value}, f"{kind}.{name}: {value!r} is not allowed; give {allowed}") for name, value in names]


SETTINGS = [  # settings of one environment and of many, and the beginning of the message
    ({"method": "euler"}, "method: 'euler' is not allowed; give one of semi_implicit_euler, rk4"),
    ({"step": 0.003}, "step: 0.003 is not allowed; give a number of seconds that divides the control period, 0.02 s"),
    ({"step": 0.05}, "step: 0.05 is not allowed; give a number of seconds that divides the control period, 0.02 s"),
    ({"step": 0.0}, "step: 0.0 is not allowed; give a finite number > 0 (s)"),
    ({"control_period": 0.0}, "control_period: 0.0 is not allowed; give a finite number > 0 (s)"),
    ({"horizon": -1.0}, "horizon: -1.0 is not allowed; give a finite number > 0 (s)"),
    ({"horizon": 0.001}, "horizon: 0.001 is not allowed; give 1 to 1000000000 control periods of 0.02 s"),
    ({"drive_bandwidth": 0.0}, "drive_bandwidth: 0.0 is not allowed; give a finite number > 0 (Hz)"),
    ({"energy_alarm": -1.0}, "energy_alarm: -1.0 is not allowed"),
    ({"torque_limit": -1.0}, "torque_limit: -1.0 is not allowed; give a finite number > 0"),
    ({"torque_limit": (400.0, 400.0)}, "torque_limit: (400.0, 400.0) is not allowed; give 3 numbers (N m)"),
    ({"torque_limit": (400.0, -1.0, 400.0)}, "torque_limit[1]: -1.0 is not allowed; give a finite number > 0"),
    ({"arm": PLANAR}, "torque_limit: None is not allowed; give one number (N m), or one for each"),
    ({"arm": 3}, "arm: 3 is not allowed; give an Arm"),
    ({"modes": 13}, "modes[0]: 13 is not allowed; give at most 12"),
    ({"modes": (4, 4)}, "modes: (4, 4) is not allowed; give one value, or 3"),
    ({"elements": 0}, "ModelChoice.elements: 0 is not allowed; give a whole number from 1"),
    ({"limits": 4.0}, "limits: 4.0 is not allowed; give a mapping with some of angle, rate, twist, deflection, deflec"),
    ({"action_repeat": 0}, "action_repeat: 0 is not allowed; give a whole number from 1 to 1000"),
    ({"action_repeat": 2.5}, "action_repeat: 2.5 is not allowed; give a whole number from 1 to 1000"),
    ({"history": 0}, "history: 0 is not allowed; give a whole number from 1 to 1000"),
    ({"history": (0.0,)}, "history[0]: 0.0 is not allowed; give a finite number > 0 (s)"),
    ({"history": ()}, "history: () is not allowed; give a whole number"),
    ({"info_keys": ("colour",)}, "info_keys: 'colour' is not allowed; give one of motor_angles"),
    ({"info_keys": 3}, "info_keys: 3 is not allowed; give a list of names"),
    ({"name": "FlexRRR"}, "name: 'FlexRRR' is not allowed; give one of FlexRRR-v0"),
    ({"name": "FlexTwo-v0"}, f"name: 'FlexTwo-v0' is not allowed; give one of {', '.join(NAMED_ENVIRONMENTS)}"),
    ({"task": "slow"}, "task: 'slow' is not allowed; give one of slew"),
    ({"task": {"reward": "bells"}}, "task: {'reward': 'bells'} is not allowed; give one of slew, track, hold, a mapp"),
    ({"task": 5}, "task: 5 is not allowed; give one of slew, track, hold, a mapping with that at kind"),
    ({"task": find_sensors("full")}, "task: (FullState(),) is not allowed; give one of slew, track, hold, a mapping"),
    ({"task": Slew}, BOTH_KINDS),
    ({"sensors": 3}, "sensors: 3 is not allowed; give a Sensor: an object with the methods entries and read"),
    ({"sensors": "lidar"}, "sensors: 'lidar' is not allowed; give one of full"),
    ({"sensors": ("full", "full")}, "sensors: 'motor_angles' is not allowed; give each entry once"),
    ({"sensors": Quantities(("colour",))}, "Quantities.names: 'colour' is not allowed; give one of motor_angles"),
    ({"base": "pid"}, "base: 'pid' is not allowed; give one of pd, pd-torque, lqr, lqr-tracking"),
    ({"base": PD}, "base: <class 'flexman_gym.agent.pd.PD'> is not allowed; give None, one of pd, pd-torque, lqr"),
    ({"base": Nosy([1.0] * 3, [1.0] * 3, 400.0)}, "sensors: 'nose' is not allowed; give one of full, fine, servo, st"),
    ({"base": 3}, "base: 3 is not allowed; give None, one of pd, pd-torque, lqr, lqr-tracking, "),
    ({"base": "pd", "arm": fm.catalog.one_joint(), "settings": "named"}, "gains: None is not allowed; give those"),
    ({"base": "pd", "gains": 3}, "gains: 3 is not allowed; give a mapping with some of stiffness, damping"),
    ({"base": "pd", "gains": {"stiffness": (5.0, 2.0, 1.0)}}, "gains: {'stiffness': (5.0, 2.0, 1.0)} is not allowed; "
     "give a mapping with stiffness (N m/rad) and"),
    ({"actions": "force"}, "actions: 'force' is not allowed; give one of torque, current, voltage, velocity, position"),
    ({"actions": "current"}, "actions: 'current' is not allowed; give current for an arm with a motor"),
    ({"randomisation": 3}, "randomisation: 3 is not allowed; give a Randomisation, or a dict of its arguments"),
    ({"task": Hold(load=(2.0, 1.0))}, "Randomisation.tip_load: (2.0, 1.0) is not allowed; give a range (low, high) with"
     " low <= high"),
    *(({"reward": wrong}, "reward") for wrong in ({"tip_error": "1"}, {"tip_error": np.inf}, 3.0, "distanc")),
    ({"reward": {1: 1.0}}, "a key of reward: 1 is not allowed; give a string"),
]  # fmt: skip
SERVOS = [  # settings of the action modes of the toolbox, and the beginning of the message
    ({"actions": "position", "base": "pd"}, "base: <flexman_gym.agent.pd.PD object at "),
    ({"actions": {"kind": "position", "range": [1.0, 2.0]}}, "actions.range: [1.0, 2.0] is not allowed; give 3 number"),
    ({"actions": {"kind": "velocity", "range": 0.0}}, "actions.range[0]: 0.0 is not allowed"),
    ({"actions": {"kind": "velocity", "stiffness": [1.0]}}, "PD.damping: "),
    ({"actions": {"kind": "velocity", "gain": 1.0}}, "actions: 'gain' is not allowed; give one of stiffness, damping"),
]
RANDOMISED = [  # ranges of physical parameters, and the beginning of the message
    ({"payload_mass": 3.0}, "Randomisation.payload_mass: 3.0 is not allowed; give a list of numbers"),
    ({"payload_mass": (3.0, 1.0)}, "Randomisation.payload_mass: (3.0, 1.0) is not allowed; give a range (low"),
    ({"payload_mass": (-1.0, 1.0)}, "Randomisation.payload_mass: -1.0 is not allowed; give a finite number >= 0"),
    ({"link_stiffness_factor": (0.0, 1.0)}, "Randomisation.link_stiffness_factor: 0.0 is not allowed"),
    ({"sensor_noise": (0.0, np.inf)}, "Randomisation.sensor_noise[1]: inf is not allowed; give a finite number"),
    ({"delay": (0, 1.5)}, "Randomisation.delay: 1.5 is not allowed; give a whole number from 0"),
    ({"sensor_noise": (0.0, 1e300)}, "Randomisation.sensor_noise: 1e+300 is not allowed; give a fraction"),
    ({"impulse_gap": 0.0}, "Randomisation.impulse_gap: 0.0 is not allowed; give a finite number > 0"),
    ({"impulse_gap": 0.01}, "Randomisation.impulse_gap: 0.01 is not allowed; give at least the control period"),
    ({"initial_vibration": (0.0, 9.0)}, "Randomisation.initial_vibration: (0.0, 9.0) is not allowed; give at most"),
    ({"mass": (0.0, 9.0)}, "randomisation: 'mass' is not allowed; give a range of help(fm.Rando"),
]  # fmt: skip
ONE = [({"render_mode": "ansi"}, "render_mode: 'ansi' is not allowed; give one of human, rgb_array")]
MANY = [
    ({"num_envs": 0}, "num_envs: 0 is not allowed; give a whole number from 1"),
    ({"autoreset_mode": "later"}, "autoreset_mode: 'later' is not allowed; give one of NextStep, SameStep"),
    ({"max_episode_steps": 0}, "max_episode_steps: 0 is not allowed; give a whole number from 1"),
    ({"threads": 0}, "threads: 0 is not allowed; give a whole number from 1"),
    ({"render_mode": "human"}, "render_mode: 'human' is not allowed; give one of rgb_array"),
    ({"infos": "never"}, "infos: 'never' is not allowed; give one of always, at end"),
    ({"seed_stride": 0}, "seed_stride: 0 is not allowed; give a whole number from 1"),
]
TASKS = {
    Slew: [
        *numbers("Slew", "a finite number", ("start", -0.1), ("start", "far"), ("slew", 0.0), ("slew", np.inf)),
        *numbers("Slew", "a finite number", ("failure_penalty", np.nan)),
        ({"pairs": -1}, "Slew.pairs: -1 is not allowed"),
    ],
    Track: [
        ({"path": "spiral"}, "Track.path: 'spiral' is not allowed; give one of circle, lemniscate, smooth, any"),
        ({"size": 0.0}, "Track.size: 0.0 is not allowed; give a finite number > 0 (of the reach)"),
        ({"period": (3.0, 2.0)}, "Track.period: (3.0, 2.0) is not allowed; give a range (low, high) with 0 < low <= h"),
        ({"period": 3.0}, "Track.period: 3.0 is not allowed; give a list of"),
        ({"preview": (0.0,)}, "Track.preview[0]: 0.0 is not allowed; give a finite number > 0 (s)"),
        ({"middle": -1.0}, "Track.middle: -1.0 is not allowed; give a finite number > 0 (rad)"),
        *numbers("Track", "a finite number >= 0", ("failure_penalty", -1.0)),
    ],
    Hold: [
        ({"start": -1.0}, "Hold.start: -1.0 is not allowed; give a finite number >= 0 (rad)"),
        ({"gap": 0.0}, "Hold.gap: 0.0 is not allowed; give a finite number > 0 (s)"),
        ({"impulse": 3.0}, "Hold.impulse: 3.0 is not allowed; give a list of"),
        ({"load": (1.0,)}, "Hold.load: (1.0,) is not allowed; give 2 numbers (N)"),
        *numbers("Hold", "a finite number >= 0", ("failure_penalty", -1.0)),
    ],
}
PLAIN = [  # environments of a file, and the beginning of the message
    ([1], "environment: [1] is not allowed; give a mapping with id and settings"),
    ({"id": "CartPole-v1"}, "id: 'CartPole-v1' is not allowed; give one of FlexRRR-v0"),
    ({"id": 3}, "id: 3 is not allowed; give one of FlexRRR-v0"),
    ({"name": "FlexOne-v0"}, "name: 'FlexOne-v0' is not allowed; give it as id"),
    ({"randomization": {}}, "randomization: {} is not allowed; give a setting: the nearest is randomisation"),
    (
        {"randomisation": {"mass": [0, 1]}},
        "randomisation: 'mass' is not allowed; give a range of help(fm.Rando",
    ),
    ({"limits": 3}, "limits: 3 is not allowed; give a mapping with some of angle, rate, twist"),
    ({"limits": {"speed": 3}}, "limits: 'speed' is not allowed; give one of angle, rate, twist"),
    ({"limits": {"rate": -1}}, "Limits.rate: -1 is not allowed; give a finite number > 0"),
    ({"task": 3}, "task: 3 is not allowed; give one of slew, track, hold, a mapping with"),
    ({"task": "reach"}, "task: 'reach' is not allowed; give one of slew, track"),
    ({"task": {"kind": "slew", "goal": 1}}, "task: 'goal' is not allowed; give one of start, slew"),
    ({"arm": "puma"}, "arm: 'puma' is not allowed; give one of apkarian_1998, de_luca_siciliano"),
    ({"arm": 3}, "arm: 3 is not allowed; give an Arm, a mapping, a file"),
    ({"arm": {"catalog": "paper_rrr", "payload": {"mas": 1}}}, "arm.payload.mas: 1 is not allowed; give only the"),
    ({"arm": {"catalog": "vertical_2r", "color": 1}}, "arm: "),
    ({"sensors": ["nose"]}, "sensors: 'nose' is not allowed; give one of full, fine, servo, state"),
    ({"action_repeat": "5"}, "action_repeat: '5' is not allowed; give a whole number from 1 to 1000"),
]
SENSORS = [
    ("nose", "sensors: 'nose' is not allowed; give one of full, fine"),
    ({"noise": 1}, "sensors: {'noise': 1} is not allowed; give a mapping with the name of a sensor at kind"),
    ({"kind": "lab", "hum": 1}, "sensors: 'hum' is not allowed; give one of noise, bias, quantisation, delay"),
    ({"kind": "full", "noise": -1.0}, "sensors.noise: -1.0 is not allowed; give a finite number >= 0"),
    ({"kind": "full", "noise": 1e300}, "sensors.noise: 1e+300 is not allowed; give a fraction from 0 to 1"),
    ({"kind": "full", "quantisation": 1e-300}, "sensors.quantisation: 1e-300 is not allowed; give 0, or a fraction"),
    ({"kind": "full", "delay": 0.5}, "sensors.delay: 0.5 is not allowed; give a whole number from 0 to 1000"),
    ({"kind": "full", "every": 0}, "sensors.every: 0 is not allowed; give a whole number from 1 to 1000"),
    ({"kind": "full", "dropped": 1.0}, "sensors.dropped: 1.0 is not allowed; give a probability from 0 to below 1"),
    ({"kind": "command", "noise": 0.1}, "sensors: "),
]  # fmt: skip
FOREIGN = [  # names that settings have elsewhere, and what they are called here
    ({"gravity": (0.0, 0.0, -9.81)}, "gravity belongs to it: arm=fm.Arm(..., gravity="),
    ({"max_steps": 500}, "horizon, the time in s after which"),
    ({"frame_skip": 4}, "action_repeat, the number of control periods for which"),
    ({"payload": 1.0}, "arm=fm.Arm(..., payload=fm.Payload(0.5))"),
    ({"dt": 0.01}, "control_period, the time in s between two actions"),
    ({"control_periods": 0.01}, "a setting: the nearest is control_period"),
    ({"delay": 1}, 'randomisation={"delay": (1, 1)}'),
]


@pytest.mark.parametrize(
    ("settings", "line"),
    [*SETTINGS, *(({"randomisation": each}, line) for each, line in RANDOMISED),
     *(pytest.param(*row, marks=pytest.mark.feature) for row in SERVOS)],
)  # fmt: skip
def test_a_setting_is_refused_by_one_environment_and_by_many(settings, line):
    for make in (FlexManEnv, lambda **settings: FlexManVectorEnv(2, **settings)):
        assert refusal(lambda make=make: make(**settings)).startswith(line)


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        ({"modes": 0, "randomisation": {"link_stiffness_factor": (0.9, 1.1)}}, "link"),
        ({"modes": 0, "randomisation": {"initial_vibration": (0.0, 1e-3)}}, "link"),
        ({**RIGID_JOINT, "randomisation": {"joint_stiffness_factor": (0.9, 1.1)}}, "joint"),
        ({**RIGID_JOINT, "randomisation": {"joint_damping": (0.0, 1.0)}}, "joint"),
    ],
)
def test_effects_that_a_rigid_arm_has_no_room_for_are_refused(settings, part):
    assert refusal(lambda: FlexManEnv(**settings)).endswith(f"give None: every {part} of this arm is rigid")


@pytest.mark.parametrize(
    ("make", "settings", "line"),
    [(make, *row) for make, rows in {FlexManEnv: ONE, FlexManVectorEnv: MANY, **TASKS}.items() for row in rows],
)
def test_an_argument_is_refused(make, settings, line):
    assert refusal(lambda: make(**settings)).startswith(line)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "wide", None, True])
def test_a_limit_is_a_positive_number(value):
    for field in fields(fm.Limits)[:6]:
        line = refusal(lambda field=field: fm.Limits(**{field.name: value}))
        assert line == f"Limits.{field.name}: {value!r} is not allowed; give a finite number > 0"


@pytest.mark.parametrize(("value", "line"), SENSORS)
def test_sensors_are_refused(value, line):
    assert refusal(find_sensors, value).startswith(line)


@pytest.mark.parametrize(("data", "line"), PLAIN)
def test_a_file_is_refused_as_its_data_are(tmp_path, data, line):
    assert refusal(Configuration.from_plain, data).startswith(line)
    files.write_data(tmp_path / "own.json", data)
    said = line if isinstance(data, dict) else "this is no mapping; give names with their values"
    assert refusal(Configuration.load, tmp_path / "own.json").startswith(f"{tmp_path / 'own.json'}: {said}")


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("FlexRRR-v0/X", "condition: 'X' is not allowed; give one of nominal, delay, friction, payload, random-delay"),
        ("FlexOne-v0/unknown", "condition: 'FlexOne-v0/unknown' is not allowed; give one for FlexRRR-v0, "),
    ],
)
def test_a_condition_is_refused_where_there_is_none_of_that_name(name, line):
    assert refusal(Configuration.find, name).startswith(line)


@pytest.mark.parametrize("make", [FlexManEnv, FlexManVectorEnv])
@pytest.mark.parametrize(
    ("wrong", "near"),
    [("randomization", "randomisation"), ("control_freq", "control_period"), ("stifening", "stif"),
     ("renderer", "render_"), ("task_", "task"), ("torque_limits", "torque_limit")],
)  # fmt: skip
def test_an_unknown_keyword_is_refused_with_the_nearest_known_one(make, wrong, near):
    with pytest.raises(
        ValueError, match=rf"^{wrong}: 1 is not allowed; give a setting: the nearest is {near}"
    ) as error:
        make(**{wrong: 1})
    assert "\n" not in str(error.value) and all(name in str(error.value) for name in DECLARED)


@pytest.mark.parametrize(("setting", "said"), FOREIGN)
def test_a_setting_of_another_name_is_refused_with_the_one_it_has_here(setting, said):
    line = refusal(lambda: FlexManEnv(name="FlexOne-v0", **setting))
    assert line.startswith(f"{next(iter(setting))}: ") and said in line
