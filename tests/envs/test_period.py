"""Control period: order of its stages, arms that do not move, and limits of observations at the end of a command."""

from copy import deepcopy

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym  # noqa: F401  registers the environments
from flexman_gym.envs.period import advance


def begun(**settings):
    """Return the episodes of three planar arms under PD control with lagging motors, after a few periods."""
    venv = gym.make_vec("FlexPlanar-v0", 3, "vector_entry_point", base="pd", drive_bandwidth=20.0, **settings)
    venv.reset(seed=4)
    for _ in range(3):
        venv.step(np.full((3, 2), 0.2, dtype=np.float32))
    return venv.unwrapped.episodes


def test_motion_follows_from_the_readings_of_the_period_before():
    episodes, other = begun(), begun()
    batch, motors, readings = other.batch, other.motors, deepcopy(episodes.readings)
    actions = other.agent.act(other.readings, other.view.action.copy(), ~other.over)
    drive = motors.drive.copy()
    drive[:, :2] = motors.lagged(actions) * motors.limits
    batch.step(drive)
    assert advance(episodes, episodes.every)
    assert np.array_equal(episodes.batch.rows, batch.rows) and np.array_equal(episodes.view.action, actions)
    assert np.array_equal(episodes.view.motor_angles, batch.rows[:, batch.model.motor_columns])
    assert any(not np.array_equal(each, readings[name]) for name, each in episodes.readings.items())


def test_arms_outside_the_mask_keep_state_readings_and_age():
    episodes = begun()
    moving, rows = np.array([True, False, True]), episodes.batch.rows.copy()
    ages, before = episodes.ages.copy(), deepcopy(episodes.readings)
    advance(episodes, moving)
    assert (episodes.batch.rows != rows).any(axis=1).tolist() == moving.tolist()
    assert (episodes.ages - ages).tolist() == [1, 0, 1]
    assert all(np.array_equal(each[1], before[name][1]) for name, each in episodes.readings.items())


@pytest.mark.parametrize("repeat", [1, 3])
def test_the_last_period_of_a_command_is_said(repeat):
    episodes = begun(action_repeat=repeat)
    assert [advance(episodes, episodes.every) for _ in range(6)] == [i % repeat == repeat - 1 for i in range(6)]
