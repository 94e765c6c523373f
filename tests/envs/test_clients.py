"""Patterns of training libraries: actions that are not clipped, and infos that are stacked."""

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.infos import INFO_MODES, flat_info
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.kernels import layout

from oracles.assertions import refusal
from oracles.random_inputs import actions

RICH = {
    "base": "adaptive-lqr", "limits": {"strain": 1e-4, "rate": 2.0, "on_violation": "cost"}, "safety": True,
    "randomisation": {"payload_mass": (0.0, 0.1)}, "info_keys": ["motor_angles"],
}  # fmt: skip


def both(**settings):
    """A single environment and a vector environment with two arms, after a reset."""
    for env in (FlexManEnv(name="FlexOne-v0", **settings), FlexManVectorEnv(2, name="FlexOne-v0", **settings)):
        env.reset(seed=0)
        yield env


@pytest.mark.feature
@pytest.mark.parametrize("settings", [{}, {"base": "pd"}, {"action_repeat": 2}, {"actions": "position"}], ids=str)
def test_clipped_action_has_the_effect_of_the_action_at_the_bound(settings):
    for beyond, bound in zip(both(clip_actions=True, **settings), both(**settings), strict=True):
        for value in (1.0 + 1e-5, 3.0, -1e6, 0.4):
            action = np.full(beyond.action_space.shape, value, dtype=np.float32)
            np.testing.assert_equal(beyond.step(action), bound.step(np.clip(action, -1.0, 1.0)))


def test_action_beyond_the_bound_is_refused_with_the_setting_that_clips_it():
    for env in both():
        line = refusal(env.step, np.full(env.action_space.shape, 1.5, dtype=np.float32))
        assert " from -1 to 1, or gym.make(..., clip_actions=True)" in line


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("clip", [False, True])
def test_action_that_is_not_finite_is_refused_even_if_actions_are_clipped(clip, value):
    for env in both(clip_actions=clip):
        before = env.episodes.batch.rows.copy()
        assert "clip_actions" not in refusal(env.step, np.full(env.action_space.shape, value, dtype=np.float32))
        assert np.array_equal(env.episodes.batch.rows, before)


def test_rollout_clips_the_actions_of_a_law_if_the_environment_does():
    agent = AgentSpec("two", lambda observations: np.full((len(observations), 1), 2.0), None)
    clipped, refused = (Configuration("FlexOne-v0", {"clip_actions": clip, "horizon": 0.1}) for clip in (True, False))
    assert (fm.rollout(agent, clipped, [0]).actions == 1.0).all()
    assert "clip_actions" in refusal(fm.rollout, agent, refused, [0])


def leaves(info, prefix=""):
    """Yield key and value of every entry of a nested info."""
    for key, value in info.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{key}/")
        else:
            yield f"{prefix}{key}", value


@pytest.mark.feature
@pytest.mark.slow
def test_flat_info_has_every_number_of_the_nested_info():
    from flexman_gym.toolbox.safety.safety_filter import STATUS

    numbers = {"status": layout.STATUS.index, "safety_status": STATUS.index, "failure": bool}
    for nested, flat in zip(both(**RICH), both(infos="flat", **RICH), strict=True):
        for value in (0.1, -0.5, 0.2):
            action = np.full(nested.action_space.shape, value, dtype=np.float32)
            whole, ours = nested.step(action)[-1], flat.step(action)[-1]
            told = {key: each for key, each in leaves(whole) if "/_" not in key and key[0] != "_"}
            assert {key for key in ours if key[0] != "_"} == told.keys() - {"method"}
            assert {"reward_terms/distance", "drawn/payload_mass", "limits/strain"} <= ours.keys()
            assert {"estimates/payload_mass", "cost", "motor_angles", "safety_change"} <= ours.keys()
            for key in told.keys() - {"method"}:
                number = numbers.get(key)
                assert np.array_equal(ours[key], np.vectorize(number)(told[key]) if number else told[key])


def test_flat_info_names_a_failure_and_leaves_out_objects():
    env = FlexManEnv(name="FlexOne-v0", infos="flat", limits={"rate": 0.5})
    env.reset(seed=0)
    ended = False
    while not ended:
        *_, ended, truncated, info = env.step(np.ones(1, dtype=np.float32))
        assert info["failure"] is ended and not truncated and info["reward_terms/failure"] <= 0.0
    assert flat_info({"text": "a", "object": object(), "none": None, "list": ["a"], "number": 2}) == {"number": 2}


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize("form", ["flat", "none"])
def test_infos_of_a_vector_environment_are_stacked_into_arrays(mode, form):
    """The loop of a client: one array of numbers for each key, with the same keys and shapes in every step."""
    env = gym.make_vec("FlexOne-v0", 3, infos=form, autoreset_mode=mode, max_episode_steps=3)
    infos = [env.reset(seed=0)[1]]
    ends = 0
    for action in actions(3, 8):
        *_, truncated, info = env.step(action[:, :1])
        if mode == "SameStep" and truncated.any():
            ends += 1
            assert info["_final_obs"].all() and info["final_obs"][0].shape == env.single_observation_space.shape
            final = info["final_info"]
            assert all(final[key].dtype.kind in "biuf" for key in final) and bool(final) == (form == "flat")
        info = {key: value for key, value in info.items() if "final" not in key}
        infos.append(info)
        if mode == "Disabled" and truncated.any():
            env.reset(options={"reset_mask": truncated})
    for key in infos[0]:
        stacked = np.stack([info[key] for info in infos])
        assert stacked.dtype.kind in "biuf" and stacked.shape[:2] == (9, 3)
    assert all(info.keys() == infos[0].keys() for info in infos) and bool(infos[0]) == (form == "flat")
    assert (ends > 0) == (mode == "SameStep")


def test_flat_infos_equal_those_of_gymnasiums_vector_environment():
    ours = gym.make_vec("FlexOne-v0", 2, infos="flat", max_episode_steps=3)
    theirs = gym.make_vec("FlexOne-v0", 2, vectorization_mode="sync", infos="flat")
    one, other = ours.reset(seed=[1, 2])[1], theirs.reset(seed=[1, 2])[1]
    assert one.keys() == other.keys()
    for key, value in one.items():
        assert np.array_equal(value, other[key])


def test_info_of_a_single_environment_is_there_when_it_is_asked_for():
    environments = {mode: FlexManEnv(name="FlexOne-v0", infos=mode, horizon=0.06) for mode in INFO_MODES}
    given = {mode: [env.reset(seed=0)[1]] for mode, env in environments.items()}
    for _ in range(3):
        for mode, env in environments.items():
            given[mode].append(env.step(np.zeros(1, dtype=np.float32))[-1])
    assert given["none"] == [{}] * 4 and given["at end"][:3] == [{}] * 3
    np.testing.assert_equal(given["at end"][3], given["always"][3])
    assert refusal(lambda: FlexManEnv(infos="flatt")).endswith("; the nearest is flat")
