"""Rewards: terms of a task may have weights, a function may take their place, and a spec says how long it goes on."""

import gymnasium as gym
import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.tasks import Slew
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.assertions import refusal

ACTIONS = np.random.default_rng(0).uniform(-0.3, 0.3, (5, 3)).astype(np.float32)


def played(**settings):
    """Reward and info of each of some steps."""
    env = FlexManEnv(**settings)
    env.reset(seed=1)
    return [(reward, info) for _, reward, _, _, info in map(env.step, ACTIONS)]


def test_weights_multiply_terms():
    plain, weighed = played(), played(reward={"tip_error": 2.0, "effort": 0.0})
    for (_, info), (reward, other) in zip(plain, weighed, strict=True):
        terms = info["reward_terms"]
        assert reward == pytest.approx(2.0 * terms["tip_error"] + terms["tip_vibration"], rel=1e-14)
        assert other["reward_terms"]["effort"] == 0.0 < terms["effort"]
        assert other["reward_terms"]["tip_vibration"] == terms["tip_vibration"]


def test_a_function_takes_their_place_for_one_arm_and_for_many():
    def own(view):
        return -view.tip_error - 0.1 * view.tip_vibration

    for reward, info in played(reward=own):
        assert reward == -info["tip_error"] - 0.1 * info["tip_vibration"] == info["reward_terms"]["own"]
    many = FlexManVectorEnv(2, reward=own)
    many.reset(seed=1)
    rewards = [many.step(np.stack([each, each]))[1] for each in ACTIONS]
    assert [each[0] for each in rewards] == [reward for reward, _ in played(reward=own)]


def test_a_file_holds_weights_and_no_function():
    weights = {"distance": 0.5}
    whole = Configuration.from_plain({"id": "FlexOne-v0", "reward": weights}).to_plain()
    assert whole["reward"] == weights == Configuration.from_plain(whole).to_plain()["reward"]
    assert refusal(FlexManEnv(reward=len).configuration.to_plain).startswith("reward: ")


def test_the_sum_of_terms_rounds_for_one_arm_as_for_many():
    """The built-in sum of floats is compensated from Python 3.12 on: it would be 2 for one arm, and 0 for many."""

    class Steep(Slew):
        def reward_terms(self, view):
            return {
                name: each + 0.0 * view.effort for name, each in zip("abcd", (1.0, 1e100, 1.0, -1e100), strict=True)
            }

    one, two = FlexManEnv(task=Steep()), FlexManVectorEnv(2, task=Steep())
    for env in (one, two):
        env.reset(seed=1)
    assert one.step(ACTIONS[0])[1] == two.step(ACTIONS[:2])[1][0] == 0.0


def test_the_name_of_a_reward_is_that_of_the_task():
    """The same numbers as with the task that has it, in files and after another change too."""
    named, given = Configuration("FlexRRR-v0", {"reward": "distance"}), {"task": Slew(reward="distance")}
    assert named == Configuration("FlexRRR-v0", given) and named.task.reward == "distance"
    assert Configuration.from_plain(named.to_plain()).replace(horizon=1.0).task == named.task
    envs = [FlexManEnv(reward="distance"), FlexManEnv(task={"kind": "slew", "reward": "distance"})]
    assert len({env.reset(seed=3) and env.step(ACTIONS[0])[1] for env in envs}) == 1
    assert list(envs[0].step(ACTIONS[0])[4]["reward_terms"]) == ["distance", "failure"]
    assert FlexManEnv(reward="exponential", task=Slew(slew=0.1)).configuration.task == Slew(
        slew=0.1, reward="exponential"
    )
    assert Configuration("FlexRRR-Track-v0", {"reward": "distance"}) == Configuration("FlexRRR-Track-v0")


def test_the_name_of_no_reward_of_the_task_is_refused():
    line = refusal(lambda: FlexManEnv(reward="distanc"))
    assert line.startswith("reward: 'distanc' is not allowed; give bells, distance, exponential, a mapping of weights")
    line = refusal(lambda: Configuration("FlexRRR-Hold-v0", {"reward": "bells"}))
    assert line.startswith("reward: 'bells' is not allowed; give distance, a mapping of weights")


def test_a_weight_of_no_term_is_refused_at_the_first_step():
    env = FlexManEnv(reward={"distance": 1.0})
    line = refusal(env.reset)
    assert line.startswith("reward: ") and "tip_error" in line


def test_the_spec_has_the_steps_of_an_episode():
    for settings, steps in (({}, 500), ({"action_repeat": 5}, 100), ({"horizon": 0.3, "action_repeat": 2}, 8),
                            ({"horizon": 20.0}, 1000)):  # fmt: skip
        env = gym.make("FlexRRR-v0", **settings)
        assert env.spec.max_episode_steps == steps
    env = gym.make("FlexRRR-v0", horizon=0.1, action_repeat=2)
    env.reset(seed=0)
    ends = [env.step(np.zeros(3, dtype=np.float32))[3] for _ in range(env.spec.max_episode_steps)]
    assert ends == [False, False, True]
    assert gym.make(env.spec).spec.max_episode_steps == 3
    assert gym.make("FlexRRR-v0", max_episode_steps=7).spec.max_episode_steps == 7
