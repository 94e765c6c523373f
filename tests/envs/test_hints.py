"""Hints: what somebody types into `gym.make` first is answered with what it is called here."""

import warnings

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.description import CONDITIONS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv


def line_of(call, kind=ValueError):
    """The one line of an error."""
    with pytest.raises(kind) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_delay_is_part_of_the_randomisation():
    line = line_of(lambda: gym.make("FlexOne-v0", delay=1))
    assert line.startswith("delay: 1 is not allowed") and 'randomisation={"delay": (1, 1)}' in line
    env = gym.make("FlexOne-v0", randomisation={"delay": (1, 1)})
    assert env.unwrapped.setup.latest_delay == 1


@pytest.mark.parametrize("condition", CONDITIONS)
def test_an_id_with_a_condition_is_answered_with_the_keyword(condition):
    wanted = f'gym.make("FlexRRR-v0", condition="{condition}")'
    assert wanted in line_of(lambda: gym.make(f"FlexRRR-v0/{condition}"))
    assert wanted in line_of(lambda: gym.make_vec(f"FlexRRR-v0/{condition}", 2, "vector_entry_point", base="pd"))


@pytest.mark.parametrize(("horizon", "warned"), [(500, True), (1000.0, True), (20.0, False), (100.0, False)])
def test_a_horizon_in_steps_is_warned_of(horizon, warned):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        FlexManEnv(name="FlexOne-v0", horizon=horizon)
    lines = [str(each.message) for each in caught]
    assert len(lines) == warned
    assert not warned or (lines[0].startswith(f"horizon: {horizon:g} (s)") and "steps" in lines[0])


def misspelt(view):
    """A reward with a slip."""
    return -view.tip_eror


def nothing(view):
    """A reward that forgets its return."""
    view.tip_error  # noqa: B018


def words(view):
    """A reward that is no number."""
    return "far"


def too_many(view):
    """A reward of every coordinate of the tip."""
    return np.ones((3, 7))


@pytest.mark.parametrize("reward", [misspelt, nothing, words, too_many])
@pytest.mark.parametrize("made", [lambda **own: FlexManEnv(**own), lambda **own: FlexManVectorEnv(2, **own)])
def test_a_reward_function_that_fails_is_named_with_the_names_of_a_view(reward, made):
    env = made(name="FlexOne-v0", reward=reward)
    line = line_of(lambda: env.reset(seed=0))
    assert line.startswith(f"reward: {reward.__name__} ")
    assert all(name in line.replace(",", "").split() for name in ("tip_error", "target", "motor_rates", "failed"))
    assert ("tip_eror" in line) == (reward is misspelt) and ("None" in line) == (reward is nothing)
    assert not any(name in line.split() for name in ("read", "alone", "_one"))


def test_a_reward_may_be_a_constant_or_a_number_for_each_arm():
    for reward in (lambda view: 1, lambda view: np.float32(2.0), lambda view: view.failed, lambda view: view.tip_error):
        FlexManVectorEnv(2, name="FlexOne-v0", reward=reward).reset(seed=0)
        FlexManEnv(name="FlexOne-v0", reward=reward).reset(seed=0)


def test_the_cause_of_a_reward_that_fails_is_kept():
    with pytest.raises(ValueError) as caught:
        fm.rollout("pd", fm.envs.description.Description("FlexOne-v0", {"reward": misspelt}), 1)
    assert isinstance(caught.value.__cause__, AttributeError)
