"""Tuning: gains are drawn from where a late motor is stable, and are worth what their episodes say."""

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym  # noqa: F401  registers the environments
from flexman_gym.control import PD
from flexman_gym.envs.description import Description
from flexman_gym.evaluation import tuning


def test_no_gains_are_tried_that_the_largest_delay_makes_unstable(monkeypatch):
    """Where more damping is always better, what is found comes close to the bound and does not cross it."""
    environment = Description("FlexOne-v0", {"randomisation": {"delay": [0, 3]}})
    monkeypatch.setattr(tuning, "_rewards", lambda environment, gains, episodes: gains[:, -1])
    result, setup = tuning.tune(environment), environment.setup()
    model = gym.make(environment.id).unwrapped.simulator.model
    damped, beyond = (PD(result.stiffness, [part * result.damping[0]], setup.torque_limit) for part in (1.0, 1.1))
    assert damped.unstable(model, setup.control_period, 3) == ""
    assert beyond.unstable(model, setup.control_period, 3) != ""


def test_the_reward_is_that_of_whole_episodes_and_of_no_others():
    """Limits so tight that episodes end at different times: played one by one, they have that mean reward."""
    environment = Description("FlexOne-v0", {"horizon": 1.0, "limits": {"rate": 0.5}})
    episodes = 3
    result = tuning.tune(environment, first=6, around=2, episodes=episodes)
    gains = {"stiffness": result.stiffness, "damping": result.damping}
    env = gym.make(environment.id, base="pd", gains=gains, **environment.keywords())
    rewards, periods = [], []
    for seed in range(episodes):
        env.reset(seed=seed)
        own, over = [], False
        while not over:
            _, reward, failed, ended, _ = env.step(np.zeros(1, dtype=np.float32))
            own.append(reward)
            over = failed or ended
        rewards.append(sum(own))
        periods.append(len(own))
    assert result.reward == pytest.approx(np.mean(rewards), rel=1e-9)
    assert len(set(periods)) > 1, periods


def test_the_second_search_is_around_the_best_of_the_first(monkeypatch):
    """A reward with one peak: candidates of the second search are some 15 % away from the best so far."""
    peak, tried = np.log([0.3, 0.02]), []

    def rewards(environment, gains, episodes):
        tried.append(np.log(gains))
        return -((tried[-1] - peak) ** 2).sum(axis=1)

    monkeypatch.setattr(tuning, "_rewards", rewards)
    result = tuning.tune(Description("FlexOne-v0"))
    first, near = tried
    best = first[((first - peak) ** 2).sum(axis=1).argmin()]
    assert np.abs(near - best).max() < 5 * 0.15 and len(near) == 60
    assert -result.reward < ((best - peak) ** 2).sum(), "which finds a better one"
