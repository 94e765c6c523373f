"""Infos: those of the end of an episode alone, what may be told, and what libraries ask of a vector environment."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import flexman_gym as fm
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.assertions import same
from oracles.random_inputs import actions

SHORT = {"max_episode_steps": 7, "limits": fm.Limits(rate=1.0)}  # episodes that end either way


def pair(arms, mode, **settings):
    """An environment that says everything, and one that speaks at the end."""
    return (FlexManVectorEnv(arms, autoreset_mode=mode, infos=infos, **SHORT, **settings)
            for infos in ("always", "at end"))  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("hold", [1, 2])
@pytest.mark.parametrize("arms", [1, 3])
@pytest.mark.parametrize("mode", tuple(AutoresetMode))
def test_infos_at_the_end_are_those_of_the_arms_that_ended(mode, arms, hold):
    always, at_end = pair(arms, mode, action_repeat=hold)
    first, infos = at_end.reset(seed=1)
    assert np.array_equal(first, always.reset(seed=1)[0]) and infos == {}
    spoken = silent = 0
    for step, action in enumerate(actions(arms, 40)):
        (*theirs, told), (*ours, said) = always.step(action), at_end.step(action)
        for one, other in zip(ours, theirs, strict=True):
            same(one, other, f"step {step}")
        ended = ours[2] | ours[3]
        spoken, silent = spoken + ended.any(), silent + (not ended.any())
        if not ended.any():
            assert said == {}
        elif mode == AutoresetMode.SAME_STEP:
            same(said, {name: told[name] for name in ("final_obs", "_final_obs", "final_info", "_final_info")})
        else:
            assert said.keys() == told.keys() and np.array_equal(said["_tip"], ended)
            assert np.array_equal(said["tip"][ended], told["tip"][ended]) and not said["tip"][~ended].any()
        if mode == AutoresetMode.DISABLED and ended.any():
            assert at_end.reset(options={"reset_mask": ended.copy()})[1] == {}
            always.reset(options={"reset_mask": ended.copy()})
    assert spoken and silent


def test_environments_with_neighbouring_seeds_share_no_episode():
    """Worker 1 begins with the episode of arm 1 of worker 0 where seeds count one by one."""
    one, other = (FlexManVectorEnv(4).reset(seed=seed)[0] for seed in (3, 4))
    assert np.array_equal(one[1:], other[:-1])
    workers = [FlexManVectorEnv(4, seed_stride=4).reset(seed=seed)[0] for seed in (3, 4)]
    assert len(np.unique(np.concatenate(workers), axis=0)) == 8
    same(workers[0], FlexManVectorEnv(4).reset(seed=12)[0])


def test_the_action_that_is_told_and_seen_is_the_sum_of_agent_and_base():
    env = FlexManVectorEnv(
        2, base="pd", sensors=["servo", "action"], info_keys=["action"], action_repeat=3, autoreset_mode="SameStep"
    )
    seen, infos = env.reset(seed=0)
    place = env.sensors.slices["action"]
    assert not seen[:, place].any() and not infos["action"].any() and env.sensors.units["action"] == "1"
    for action in actions(2, 5):
        seen, *_, infos = env.step(action)
        limits = np.array(env.configuration.torque_limit)
        assert np.array_equal(infos["action"], env.episodes.motors.torques / limits), "nothing comes late here"
        assert np.array_equal(seen[:, place], infos["action"].astype(np.float32))
        assert (infos["action"] != action).any() and np.abs(infos["action"]).max() <= 1.0
    alone = gym.make("FlexRRR-v0", info_keys=["action"])
    alone.reset(seed=0)
    assert np.array_equal(alone.step(np.full(3, 0.25, dtype=np.float32))[-1]["action"], np.full(3, 0.25))


@pytest.mark.feature
@pytest.mark.slow
def test_call_gives_what_gymnasiums_own_gives():
    ours = gym.make_vec("FlexRRR-v0", 2, "vector_entry_point", render_mode="rgb_array", render_size=(80, 60))
    theirs = gym.make_vec("FlexRRR-v0", 2, "sync", render_mode="rgb_array", vector_kwargs={}, render_size=(80, 60))
    for env in (ours, theirs):
        env.reset(seed=4)
    for name in ("render", "np_random_seed", "action_space", "observation_space", "torque_limit", "render_mode"):
        for one, other in zip(ours.unwrapped.call(name), theirs.call(name), strict=True):
            assert np.array_equal(one, other) if isinstance(one, np.ndarray) else one == other, name
    assert ours.get_attr("task") == (ours.task, ours.task)
    with pytest.raises(AttributeError, match="rewarding"):
        ours.get_attr("rewarding")
    with pytest.raises(ValueError, match=r"^call: 'reset' is not allowed; give a method that an arm has alone"):
        ours.call("reset", seed=3)
