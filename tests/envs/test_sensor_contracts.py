"""Sensor contracts: every set with every environment, alone and among others, and taken back from a state."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from flexman_gym.envs import NAMED
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.episodes import ALL_PARTS, FLAWED
from oracles.equality import same_alone_and_among_others

SETS = {
    "full": "full", "fine": "fine", "servo": "servo", "lab": "lab", "all": ALL_PARTS,
    "flawed": (FLAWED, "accelerometer"), "state": "state",
}  # fmt: skip


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("name", sorted(NAMED))
def test_every_set_keeps_the_contracts_of_both_libraries(name, kind):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(name, sensors=SETS[kind]).unwrapped)
        if kind != "state":  # whose bounds the checker finds too wide
            checker.check_env(gym.make(name, sensors=SETS[kind]))


@pytest.mark.parametrize("history", [1, (0.1, 0.5)])
@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("name", ["FlexRRR-Track-v0", "FlexPlanar-Hold-v0", "FlexRRR-Gravity-v0"])
def test_one_arm_and_many_have_the_same_bits(name, kind, history):
    settings = {
        "horizon": 0.5, "sensors": SETS[kind], "hold": 2, "history": history,
        "randomisation": {"sensor_noise": (0.0, 0.01), "delay": (0, 2), "payload_mass": (0.0, 0.2)},
    }  # fmt: skip
    same_alone_and_among_others(name, **settings)


@pytest.mark.parametrize("kind", ["flawed", "all"])
def test_a_state_taken_back_goes_on_to_the_same_bits(kind):
    settings = {"sensors": SETS[kind], "history": (0.1,), "randomisation": {"sensor_noise": (0.01, 0.01)}}
    for make in (FlexManEnv, lambda **all: FlexManVectorEnv(3, **all)):
        env = make(name="FlexRRR-Hold-v0", **settings)
        env.reset(seed=4)
        action = np.full(env.action_space.shape, 0.2)
        for _ in range(7):
            env.step(action)
        other = make(name="FlexRRR-Hold-v0", **settings)
        other.set_state(env.get_state())
        for _ in range(7):
            assert np.array_equal(env.step(action)[0], other.step(action)[0])
