"""Environment: what it does not understand is refused in one line, and changes nothing."""

import numpy as np
import pytest

from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.episodes import EVERYTHING


@pytest.mark.parametrize(
    ("arguments", "field", "allowed"),
    [
        ({"method": "euler"}, "method", "one of semi_implicit_euler, rk4"),
        ({"step": 0.003}, "step", "divides the control period, 0.02 s"),
        ({"step": 0.05}, "step", "divides the control period, 0.02 s"),
        ({"step": 0.0}, "step", "a finite number > 0 (s)"),
        ({"control_period": 0.0}, "control_period", "a finite number > 0"),
        ({"torque_limit": -1.0}, "torque_limit", "a finite number > 0"),
        ({"modes": 13}, "modes[0]", "at most 12"),
        ({"modes": (4, 4)}, "modes", "one value, or 3"),
        ({"elements": 0}, "ModelChoice.elements", "a whole number from 1"),
        ({"task": "slow"}, "task", "one of slew"),
        ({"task": {"reward": "bells"}}, "task", "one of slew, track, hold, or a mapping with that at kind"),
        ({"task": 5}, "task", "a task"),
        ({"limits": 4.0}, "limits", "Limits"),
        ({"arm": 3}, "arm", "an Arm"),
        ({"render_mode": "ansi"}, "render_mode", "one of human, rgb_array"),
    ],
)
def test_a_bad_argument_is_refused_in_one_line(arguments, field, allowed):
    with pytest.raises(ValueError) as error:
        FlexManEnv(**arguments)
    refused(error, field, next(iter(arguments.values())), allowed)


@pytest.mark.parametrize(
    "action",
    [[0.0, 0.0], [[0.0, 0.0, 0.0]], [np.nan, 0.0, 0.0], [0.0, 1.001, 0.0], [0.0, -np.inf, 0.0], ["up"] * 3, None],
)
def test_a_bad_action_is_refused_in_one_line_and_changes_nothing(action):
    env = FlexManEnv()
    env.reset(seed=0)
    before = env.simulator.state.copy()
    with pytest.raises(ValueError) as error:
        env.step(action)
    refused(error, "action", action, "3 numbers from -1 to 1")
    assert np.array_equal(env.simulator.state, before) and env.simulator.time == 0.0


@pytest.mark.parametrize(
    ("options", "allowed"),
    [
        ({"speed": 1.0}, "one of start, goal_angles, start_tip, goal_tip, parameters"),
        ({"start": [5.0, 0.0, 0.0]}, "a start and a goal within the limits"),
        (3, "a dict with start, goal_angles, start_tip, goal_tip or parameters"),
    ],
)
def test_bad_options_are_refused_in_one_line_and_end_the_episode(options, allowed):
    env = FlexManEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError) as error:
        env.reset(options=options)
    refused(error, "options", "speed" if "speed" in str(options) else options, allowed)
    with pytest.raises(RuntimeError, match="reset the environment first"):
        env.step(np.zeros(3))


@pytest.mark.parametrize("name", ["start", "goal_angles"])
def test_a_bad_start_or_posture_is_named(name):
    for value in (None, [0.0, 0.0], "up"):
        with pytest.raises(ValueError) as error:
            FlexManEnv().reset(options={name: value})
        refused(error, f"options[{name!r}]", value, "numbers")


OUTSIDE = {"start": [5.0, 0.0, 0.0]}  # beyond the limits, which only a reset finds out
WRONG = [
    OUTSIDE,
    OUTSIDE | {"parameters": {"payload_mass": 3.0, "joint_damping": [1.0, 2.0, 3.0]}},
    OUTSIDE | {"goal_angles": [0.1] * 3, "parameters": {"link_stiffness": [0.9, 0.8, 0.7]}},
    {"start": "up"},
    {"speed": 1.0},
    np.zeros(3),
]
SETTINGS = [
    {},
    {"randomisation": EVERYTHING, "sensors": {"kind": "lab", "noise": 0.01, "bias": 0.01}, "history": 2},
    {"base": "pd", "method": "dopri5", "step": None, "modes": 1, "task": "hold"},
]


def same_bits(one, other):
    """Whether two observations or infos are the same to the last bit."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same_bits(one[name], other[name]) for name in one)
    return np.array_equal(one, other)


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: "-".join(settings) or "plain")
@pytest.mark.parametrize("made", [FlexManEnv, lambda **settings: FlexManVectorEnv(3, **settings)], ids=["one", "many"])
def test_a_refused_reset_is_as_if_it_had_never_been(made, settings):
    """The next reset draws what it would have drawn, and its arm has none of the refused parameters."""
    env, other = made(**settings), made(**settings)
    rest = np.zeros(env.action_space.shape, dtype=np.float32)
    for each in (env, other):
        each.reset(seed=3)
        each.step(rest)
    for number, options in enumerate(WRONG):
        with pytest.raises(ValueError, match="is not allowed; give "):
            env.reset(seed=None if number % 2 else 8, options=options)
        assert env.np_random_seed == other.np_random_seed
    assert all(map(same_bits, env.reset(), other.reset()))
    assert all(map(same_bits, env.step(rest + 0.1), other.step(rest + 0.1)))


def test_a_first_reset_that_is_refused_leaves_nothing_behind():
    env = FlexManEnv(randomisation=EVERYTHING)
    with pytest.raises(ValueError, match="within the limits"):
        env.reset(seed=1, options=OUTSIDE)
    with pytest.raises(RuntimeError, match="reset the environment first"):
        env.step(np.zeros(3))
    assert all(map(same_bits, env.reset(seed=2), FlexManEnv(randomisation=EVERYTHING).reset(seed=2)))


def test_arms_that_a_refused_reset_does_not_mean_go_on():
    settings = {"autoreset_mode": "Disabled", "randomisation": EVERYTHING}
    env, other = FlexManVectorEnv(3, **settings), FlexManVectorEnv(3, **settings)
    first = np.array([True, False, False])
    for each in (env, other):
        each.reset(seed=3)
        each.step(np.full((3, 3), 0.1))
    with pytest.raises(ValueError, match="within the limits"):
        env.reset(options=OUTSIDE | {"reset_mask": first})
    with pytest.raises(RuntimeError, match=r"the episodes of arms \[0\] are over"):
        env.step(np.zeros((3, 3)))
    result, expected = (each.reset(options={"reset_mask": first}) for each in (env, other))
    assert same_bits(result[0], expected[0])
    assert all(map(same_bits, env.step(np.zeros((3, 3))), other.step(np.zeros((3, 3)))))


def test_a_bad_seed_is_refused_in_one_line():
    for seed in ("12", 1.0, True, -1, [1], 2**128):
        with pytest.raises(ValueError) as error:
            FlexManEnv().reset(seed=seed)
        refused(error, "seed", seed, "a whole number from 0")


def refused(error, field, value, allowed):
    """Asserts that an error names field, value and what is allowed, on one line."""
    message = str(error.value)
    assert message.startswith(f"{field}: {value!r} is not allowed; give ") and allowed in message
    assert "\n" not in message
