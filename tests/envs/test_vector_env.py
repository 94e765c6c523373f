"""Vector environment: the same bits as the single environment many times over, whatever ends an episode."""

import warnings
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import flexman_gym as fm
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.assertions import same, same_side_by_side
from oracles.random_inputs import EVERYTHING, actions

MODES = tuple(AutoresetMode)
SHORT = {"max_episode_steps": 30, "limits": fm.Limits(rate=2.5)}  # episodes that end either way


def pair(arms, mode=AutoresetMode.NEXT_STEP, **settings):
    """The vector environment and Gymnasium's of as many single ones."""
    ours = gym.make_vec("FlexRRR-v0", arms, "vector_entry_point", autoreset_mode=mode, **settings)
    return ours, gym.make_vec("FlexRRR-v0", arms, "sync", vector_kwargs={"autoreset_mode": mode}, **settings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arms", "steps", "mode", "settings"),
    [
        (1, 120, MODES[0], {}),
        (64, 60, MODES[0], {"randomisation": EVERYTHING}),
        (3, 120, MODES[0], {"condition": "unmodelled"}),
        *((3, 120, mode, each) for mode in MODES for each in ({}, {"randomisation": EVERYTHING})),
    ],
    ids=lambda value: "-".join(value) or "plain" if isinstance(value, dict) else str(value),
)
def test_it_is_many_single_environments_bit_for_bit(arms, steps, mode, settings):
    ours, theirs = pair(arms, mode, **settings, **SHORT)
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    assert ours.single_observation_space == theirs.single_observation_space
    assert set(ours.metadata["render_modes"]) < set(theirs.metadata["render_modes"])  # one alone has a window, too
    assert ours.metadata | {"render_modes": []} == theirs.metadata | {"render_modes": []}
    assert all(same_side_by_side(ours, theirs, actions(arms, steps))), "both ways to end were seen"


@pytest.mark.slow
def test_threads_change_no_bit():
    """As many arms as two threads share."""
    one, two = (FlexManVectorEnv(136, threads=threads, randomisation=EVERYTHING, **SHORT) for threads in (1, 2))
    for actual, expected in zip(two.reset(seed=3), one.reset(seed=3), strict=True):
        same(actual, expected, "reset")
    for step, action in enumerate(actions(136, 60)):
        for actual, expected in zip(two.step(action), one.step(action), strict=True):
            same(actual, expected, f"step {step}")


@pytest.mark.parametrize("seed", [7, [3, 1, 2], np.array([3, 1, 2]), [4, None, 4]])
def test_seeds_are_those_of_the_single_environment(seed):
    env = FlexManVectorEnv(3)
    env.reset(seed=[11, 12, 13])
    observations, _ = env.reset(seed=seed)
    for i, each in enumerate([7, 8, 9] if isinstance(seed, int) else seed):
        alone = FlexManEnv()
        alone.reset(seed=11 + i)
        assert np.array_equal(observations[i], alone.reset(seed=None if each is None else int(each))[0])
        assert env.np_random_seed[i] == (11 + i if each is None else each)


def test_resets_without_a_seed_go_on_and_differ():
    env = FlexManVectorEnv(2)
    observations = [env.reset()[0] for _ in range(3)]
    assert all((before != after).any() for before, after in pairwise(observations))
    assert len(set(env.np_random_seed)) == 2 and len(env.np_random) == 2


def test_options_are_for_all_arms_or_for_each():
    env = FlexManVectorEnv(2, autoreset_mode="Disabled")
    start, other, goal = [0.1, 0.2, 0.3], [0.3, 0.2, 0.1], [0.5, 0.5, 0.5]
    seen, info = env.reset(options={"start": [start, other], "goal_angles": goal})
    angles = env.sensors.slices["motor_angles"]
    assert seen[:, angles] == pytest.approx(np.array([start, other]))
    assert info["goal_angles"].tolist() == [goal, goal]
    only = np.array([False, True])
    seen, info = env.reset(options={"start": start, "reset_mask": only})
    assert seen[:, angles] == pytest.approx(np.array([start, start]))
    assert (info["_tip"] == only).all() and not info["tip"][0].any()


def test_parameters_hold_from_an_episode_on_and_only_for_the_arms_that_were_reset():
    """A motor of twice the rotor inertia and one as built, at the first moment, when springs hold nothing yet."""
    env = FlexManVectorEnv(2, autoreset_mode="Disabled")
    inertia = env.batch.nominal["rotor_inertia"]
    options = {"start": [0.0] * 3, "goal_angles": [0.1] * 3}
    env.reset(options=options | {"parameters": {"rotor_inertia": np.array([inertia, 2 * inertia])}})
    for _ in range(2):
        seen, *_ = env.step(np.full((2, 3), 0.5))
        rates = seen[:, env.sensors.slices["motor_rates"]]
        assert rates[1] == pytest.approx(0.5 * rates[0], rel=0.1)
        env.reset(options=options | {"reset_mask": np.array([True, True])})
    single = FlexManEnv()
    single.reset(options=options | {"parameters": {"rotor_inertia": 2 * inertia}})
    assert np.array_equal(single.step(np.full(3, 0.5))[0], seen[1])


def test_what_was_returned_is_the_callers_to_keep():
    env = FlexManVectorEnv(2, randomisation={"torque_limit_factor": (0.5, 1.0)}, max_episode_steps=3)
    returned = [env.reset(seed=0)]
    kept = [(returned[0][0].copy(), {key: np.copy(value) for key, value in returned[0][1].items()})]
    for action in actions(2, 6):
        observations, rewards, *_, infos = env.step(action)
        returned.append((observations, infos | {"rewards": rewards}))
        kept.append((observations.copy(), {key: np.copy(value) for key, value in returned[-1][1].items()}))
    for (observations, infos), (before, old) in zip(returned, kept, strict=True):
        assert np.array_equal(observations, before)
        for key, value in old.items():
            assert np.array_equal(infos[key], value), key


@pytest.mark.feature
def test_a_frame_for_each_arm():
    env = FlexManVectorEnv(2, render_mode="rgb_array", render_size=(160, 120))
    env.reset(seed=0)
    first, second = env.render()
    assert first.shape == (120, 160, 3) and (first != second).any()
    plain = FlexManVectorEnv(1)
    with pytest.warns(UserWarning, match="render_mode"):
        assert plain.render() is None


@pytest.mark.parametrize(
    "wrapper", [gym.wrappers.vector.RecordEpisodeStatistics, gym.wrappers.vector.NormalizeObservation]
)
def test_gymnasiums_wrappers_take_it(wrapper):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = wrapper(gym.make_vec("FlexRRR-v0", 3, "vector_entry_point", max_episode_steps=5))
        env.reset(seed=0)
        for action in actions(3, 12):
            env.step(action)


@pytest.mark.parametrize(
    "bad", [np.zeros(3), np.zeros((3, 3)), np.full((2, 3), 1.001), np.full((2, 3), np.nan), [["up"] * 3] * 2, None]
)
def test_bad_actions_are_refused_in_one_line_and_change_nothing(bad):
    env = FlexManVectorEnv(2)
    env.reset(seed=0)
    before = env.batch.rows.copy()
    with pytest.raises(ValueError, match=r"^actions: .* is not allowed; give 2 rows of 3 numbers from -1 to 1(, |$)"):
        env.step(bad)
    assert np.array_equal(env.batch.rows, before)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"reset_mask": [True, False]}, "options['reset_mask']"),
        ({"reset_mask": np.zeros(2, dtype=bool)}, "options['reset_mask']"),
        ({"start": [[0.0] * 3] * 3}, "options['start']"),
        ({"start": [[0.0] * 3, [0.0] * 2]}, "options['start'][1]"),
        ({"speed": 1.0}, "options"),
        ({"parameters": 3}, "options['parameters']"),
        ({"parameters": {"mass": 3}}, "options['parameters']"),
        ({"parameters": {"payload_mass": [1.0, 2.0, 3.0]}}, "options['parameters']['payload_mass']"),
        ({"parameters": {"payload_mass": [1.0, -2.0]}}, "options['parameters']['payload_mass']"),
    ],
)
def test_bad_options_are_refused_in_one_line(options, field):
    env = FlexManVectorEnv(2)
    with pytest.raises(ValueError) as error:
        env.reset(seed=0, options=options)
    assert str(error.value).startswith(f"{field}: ") and "\n" not in str(error.value)
    with pytest.raises(ValueError, match=r"^seed: \[1\] is not allowed; give a whole number, or a list of 2$"):
        env.reset(seed=[1])


@pytest.mark.parametrize("mode", MODES)
def test_stepping_before_a_reset_is_refused(mode):
    env = FlexManVectorEnv(2, autoreset_mode=mode)
    with pytest.raises(RuntimeError, match=r"^the episodes of arms \[0, 1\] are over: reset them first$"):
        env.step(np.zeros((2, 3)))
