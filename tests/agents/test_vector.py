"""Vector: the arms behind the interface of Stable-Baselines3 are single environments side by side."""

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

import flexman_gym as fm
from flexman_agents.vector import SB3VecEnv

LIMITS = fm.Limits(rate=2.0)
STIFF = {"stiffness": (497.0, 325.0, 328.0), "damping": (950.0, 950.0, 103.0)}  # which leads to the limits


def arms_and_singles(count, action_repeat=1, **settings):
    """The adapter of the vector environment, and Stable-Baselines3's own vector of as many single environments."""
    settings = {"limits": LIMITS, "action_repeat": action_repeat, "horizon": 0.4, **settings}
    env = gym.make_vec("FlexRRR-v0", count, "vector_entry_point", autoreset_mode="SameStep", **settings)
    return SB3VecEnv(env), DummyVecEnv([lambda: gym.make("FlexRRR-v0", **settings)] * count)


@pytest.mark.slow
@pytest.mark.parametrize("base", [None, "pd"])
@pytest.mark.parametrize(("hold", "normalised"), [(1, False), (1, True), (3, False), (3, True)])
def test_arms_are_single_environments_side_by_side(hold, normalised, base):
    both = [VecMonitor(each) for each in arms_and_singles(3, hold, base=base, gains=STIFF)]
    both = [VecNormalize(each) for each in both] if normalised else both
    for each in both:
        each.seed(4)
    assert np.array_equal(*(each.reset() for each in both))
    random, ends = np.random.default_rng(0), set()
    for _ in range(100):
        actions = random.uniform(-1.0, 1.0, (3, 3)).astype(np.float32)
        (seen, rewards, dones, infos), (others, worth, ended, told) = (each.step(actions) for each in both)
        assert np.array_equal(seen, others) and np.array_equal(dones, ended)
        assert rewards == pytest.approx(worth, rel=1e-6, abs=1e-6)  # the other vector keeps single precision
        for info, expected in zip(infos, told, strict=True):
            if "terminal_observation" not in expected:
                assert info == {}
                continue
            assert info.keys() == expected.keys()
            assert np.array_equal(info["terminal_observation"], expected["terminal_observation"])
            assert info["TimeLimit.truncated"] == expected["TimeLimit.truncated"]
            assert (info["episode"]["l"], info["failure"]) == (expected["episode"]["l"], expected["failure"])
            ends.add(info["TimeLimit.truncated"])
    assert ends == {False, True}


def test_seeds_hold_for_one_reset():
    both = arms_and_singles(2)
    seen = []
    for each in both:
        each.seed(4)
        seen.append([each.reset().copy() for _ in range(3)])
    assert np.array_equal(*seen) and (seen[0][0] != seen[0][1]).any(), "the next episodes are others"


def test_there_is_a_picture_of_each_arm():
    env = gym.make_vec("FlexRRR-v0", 2, "vector_entry_point", autoreset_mode="SameStep", render_mode="rgb_array",
                       render_size=(48, 36))  # fmt: skip
    arms = SB3VecEnv(env)
    arms.seed(0)
    arms.reset()
    one, other = arms.get_images()
    assert one.shape == other.shape == (36, 48, 3) and (one != other).any()


def test_arms_tell_what_they_share_and_refuse_what_they_do_not_have():
    arms, _ = arms_and_singles(2, action_repeat=3)
    assert arms.get_attr("max_episode_steps") == [7, 7] and arms.get_attr("max_episode_steps", [1]) == [7]
    assert arms.env_is_wrapped(gym.Wrapper) == [False, False] and not arms.has_attr("nothing")
    assert arms.seed(3) == [3, 4]
    with pytest.raises(ValueError, match=r"^set_attr: 'task' is not allowed; give the attribute as a keyword"):
        arms.set_attr("task", None)
    with pytest.raises(ValueError, match=r"^env_method: 'reset' is not allowed; give a call of the method of `env`"):
        arms.env_method("reset")
    arms.set_options({"start": [0.1, 0.2, 0.3]})
    seen = arms.reset()
    assert seen[:, :3] == pytest.approx(np.array([[0.1, 0.2, 0.3]] * 2))
    assert (arms.reset()[:, :3] != seen[:, :3]).any(), "options hold for one reset"
    arms.set_options([{"start": [0.0] * 3}, {}])
    with pytest.raises(ValueError, match=r"^options: .* give the same options for all environments$"):
        arms.reset()
    with pytest.raises(ValueError, match=r"^autoreset_mode: .* give an environment made with AutoresetMode.SAME_STEP$"):
        SB3VecEnv(gym.make_vec("FlexRRR-v0", 2))
    arms.close()
