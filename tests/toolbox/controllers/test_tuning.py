"""Tuning: gains have margins with the largest delay, and are worth what their episodes say."""

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym  # noqa: F401  registers the environments
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.toolbox.controllers import tuning as optimisation
from flexman_gym.toolbox.controllers.margins import Margins, has_margins, margins, sampled_loops
from flexman_gym.toolbox.controllers.pd_design import design_pd


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 1])
def test_candidates_have_margins_with_the_largest_delay(delay, monkeypatch):
    environment = Configuration("FlexPlanar-v0", {"randomisation": {"delay": [0, delay]}})
    tried = []
    monkeypatch.setattr(
        optimisation, "_gain_returns", lambda environment, gains, episodes, workers: tried.append(gains) or gains[:, 0]
    )
    result = optimisation.tune(environment, around=3)
    model = gym.make(environment.id).unwrapped.simulator.model
    loops = [sampled_loops(model, angles, environment.control_period, delay)[0] for angles in goals(environment)]
    assert len(np.vstack(tried)) == 1 + 8 * 3
    for gains in np.vstack(tried):
        assert has_margins(loops, *np.split(gains, 2), Margins(2.0, 30.0))
    assert result.margins == margins(loops, result.stiffness, result.damping)


def goals(environment):
    """Goal angles of the first eight episodes."""
    env = gym.make(environment.id)
    return [env.reset(seed=seed)[1]["goal_angles"] for seed in range(8)]


def test_gains_without_candidates_are_those_of_the_design(monkeypatch):
    monkeypatch.setattr(optimisation, "_gain_returns", lambda environment, gains, episodes, workers: np.zeros(1))
    found = optimisation.tune("FlexOne-v0", around=0)
    assert found.gains == design_pd(Configuration("FlexOne-v0"))


def test_the_reward_is_that_of_whole_episodes_and_of_no_others():
    """Limits so tight that episodes end at different times: simulated one by one, they have that mean reward."""
    environment = Configuration("FlexOne-v0", {"horizon": 1.0, "limits": {"rate": 1.3}})
    episodes = 3
    (mean,) = optimisation._gain_returns(environment, np.array([[0.3, 0.1]]), episodes)
    gains = {"stiffness": (0.3,), "damping": (0.1,)}
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
    assert mean == pytest.approx(np.mean(rewards), rel=1e-9)
    assert len(set(periods)) > 1, periods


def test_every_round_is_around_the_best_so_far(monkeypatch):
    """A reward with one peak, which has margins: candidates of a round are some deviations away from the best."""
    peak, tried = np.log([0.6, 0.2]), []

    def rewards(environment, gains, episodes, workers):
        tried.append(np.log(gains))
        return -((tried[-1] - peak) ** 2).sum(axis=1)

    monkeypatch.setattr(optimisation, "_gain_returns", rewards)
    result = optimisation.tune(Configuration("FlexOne-v0"))
    so_far = tried[0]
    assert so_far.shape == (1, 2) and len(tried) == 9
    for near, deviation in zip(tried[1:], np.geomspace(0.5, 0.1, 8), strict=True):
        best = so_far[((so_far - peak) ** 2).sum(axis=1).argmin()]
        assert len(near) == 30 and np.abs(near - best).max() < 5 * deviation
        so_far = np.vstack([so_far, near])
    assert -result.reward < 0.01 < ((tried[0] - peak) ** 2).sum(axis=1).min()


def test_gains_that_are_evaluated_in_parts_have_the_same_rewards_to_the_bit(monkeypatch):
    gains, environment = np.geomspace(0.1, 2.0, 14).reshape(7, 2), Configuration("FlexOne-v0", {"horizon": 0.5})
    whole = optimisation._gain_returns(environment, gains, 2)
    monkeypatch.setattr(optimisation, "BLOCK_CANDIDATES", 3)
    assert optimisation._gain_returns(environment, gains, 2).tobytes() == whole.tobytes() and len(set(whole)) == 7
