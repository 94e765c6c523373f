"""Environment: what it does not understand is refused in one line, and changes nothing."""

import numpy as np
import pytest

from flexman_gym.envs.env import FlexManEnv


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
        ({"arm": "paper_rrr"}, "arm", "an Arm"),
        ({"render_mode": "human"}, "render_mode", "one of rgb_array"),
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
        ({"speed": 1.0}, "one of start, posture, parameters"),
        ({"start": [5.0, 0.0, 0.0]}, "a start and a goal within the limits"),
        (3, "a dict with start, posture or parameters"),
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


@pytest.mark.parametrize("name", ["start", "posture"])
@pytest.mark.parametrize("value", [None, [0.0, 0.0], "up"])
def test_a_bad_start_or_posture_is_named(name, value):
    with pytest.raises(ValueError) as error:
        FlexManEnv().reset(options={name: value})
    refused(error, f"options[{name!r}]", value, "numbers")


def refused(error, field, value, allowed):
    """Asserts that an error names field, value and what is allowed, on one line."""
    message = str(error.value)
    assert message.startswith(f"{field}: {value!r} is not allowed; give ") and allowed in message
    assert "\n" not in message
