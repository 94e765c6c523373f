"""Rendering: whatever an episode is about is in its picture, and Gymnasium's recorders take the frames."""

import gymnasium as gym
import numpy as np
import pytest

from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.model.deformation import curves

ARMS, SIZE = 10, (96, 72)


@pytest.mark.parametrize("name", NAMED_ENVIRONMENTS)
def test_start_goal_and_target_are_in_the_picture(name):
    env = FlexManVectorEnv(ARMS, name=name, render_mode="rgb_array", render_size=SIZE)
    env.reset(seed=5000)
    view, rendering, model = env.episodes.view, env._rendering, env.batch.model
    goals = curves(model, view.rest_states(view.goal_angles), 2).positions[:, -1, -1]
    for arm in range(ARMS):
        camera, floor = rendering._painter.camera(rendering.extent(arm))
        parts = camera.project(np.array([view.target[arm], view.tip[arm], goals[arm], np.zeros(3)])) / SIZE
        assert (parts > 0.055).all() and (parts < 0.945).all(), (name, arm)
        assert floor < min(view.target[arm, 2], view.tip[arm, 2])


def test_a_moving_goal_stays_in_the_picture():
    env = FlexManEnv(name="FlexPlanar-Track-v0", render_mode="rgb_array", render_size=SIZE)
    env.reset(seed=5000)
    camera, _ = env._rendering._painter.camera(env._rendering.extent(0))
    targets = []
    for _ in range(200):
        env.step(np.zeros(2))
        targets.append(env.episodes.view.target[0].copy())
    parts = camera.project(np.array(targets)) / SIZE
    assert np.ptp(targets, axis=0).max() > 0.1 and (parts > 0.0).all() and (parts < 1.0).all()


def test_the_options_of_a_picture_change_it_and_wrong_ones_are_refused():
    pictures = []
    for options in ({}, {"render_camera": (0.0, 40.0)}, {"render_gain": 5.0}, {"render_overlays": False}):
        env = FlexManEnv(render_mode="rgb_array", render_size=(160, 120), **options)
        env.reset(seed=0)
        env.step(np.ones(3))
        pictures.append(env.render().tobytes())
    assert len({*pictures}) == 4
    for wrong in ({"render_camera": 3.0}, {"render_gain": -1.0}, {"render_overlays": 1}, {"render_size": (1, 1)}):
        with pytest.raises(ValueError, match=rf"^{next(iter(wrong)).removeprefix('render_')}.*: "):
            FlexManEnv(render_mode="rgb_array", **wrong)
    with pytest.raises(ValueError, match=r"^render_mode: "):
        FlexManVectorEnv(2, render_mode="human")


def test_a_copy_and_a_second_run_render_the_same_bits():
    def frames(env):
        env.reset(seed=3)
        result = []
        for action in np.random.default_rng(0).uniform(-1.0, 1.0, (3, 3)):
            env.step(action)
            result.append(env.render())
        return np.array(result)

    env = FlexManEnv(render_mode="rgb_array", render_size=SIZE)
    first = frames(env)
    assert np.array_equal(frames(env), first) and len({*map(bytes, first)}) == 3


@pytest.mark.slow
def test_gymnasium_records_arms_one_by_one_and_side_by_side(tmp_path):
    pytest.importorskip("moviepy")
    env = gym.make("FlexOne-v0", render_mode="rgb_array", render_size=SIZE, horizon=0.1)
    recorded = gym.wrappers.RecordVideo(env, str(tmp_path / "one"), disable_logger=True)
    recorded.reset(seed=0)
    while not recorded.step(np.zeros(1, dtype=np.float32))[3]:
        pass
    recorded.close()
    many = gym.make_vec("FlexOne-v0", 4, "vector_entry_point", render_mode="rgb_array", render_size=SIZE)
    recorded = gym.wrappers.vector.RecordVideo(many, str(tmp_path / "many"), video_length=3, disable_logger=True)
    recorded.reset(seed=0)
    for _ in range(4):
        recorded.step(np.zeros((4, 1), dtype=np.float32))
    recorded.close()
    for folder in ("one", "many"):
        (film,) = (tmp_path / folder).glob("*.mp4")
        assert film.stat().st_size > 1000


@pytest.mark.parametrize("mode", ["rgb_array", "human"])
def test_render_before_a_reset_is_refused_in_one_line(mode):
    """By the environment without the wrappers of Gymnasium, by the vector environment and by its calls."""
    single = FlexManEnv(name="FlexOne-v0", render_mode=mode)
    if mode == "human":
        assert single.render() is None  # every step is shown
        return
    many = FlexManVectorEnv(2, name="FlexOne-v0", render_mode=mode)
    for render in (single.render, many.render, lambda: many.call("render"), lambda: many.get_attr("render")):
        with pytest.raises(
            RuntimeError, match=r"^render: there is no episode to be drawn: reset the environment first$"
        ):
            render()
    for env in (single, many):
        env.reset(seed=0)
        assert env.render() is not None
