"""Periods: what is asked of the motors, counted and kept of many arms in a control period."""

import numpy as np
import pytest

from flexman_gym.kernels import layout
from flexman_gym.kernels.periods import ask, close, outlast, within


@pytest.mark.parametrize(("value", "inside"), [(1.0, True), (-1.0, True), (1.0 + 1e-15, False), (-2.0, False)])
def test_numbers_are_within_a_bound_that_is_theirs(value, inside):
    assert within(np.array([0.5, value]), 1.0) == inside
    assert not within(np.array([value, np.nan]), 1.0)


def test_torques_reach_the_motors_and_who_is_not_playing_keeps_what_was_asked():
    random, joints = np.random.default_rng(0), 3
    actions, arriving, before = random.uniform(-1.0, 1.0, (3, 2, joints))
    limits, drive, efforts = random.uniform(1.0, 9.0, (2, joints)), np.full((2, joints + 6), 7.0), np.full(2, 7.0)
    asked = before.copy()
    ask(actions, arriving, limits, np.array([True, False]), drive, asked, efforts)
    assert np.array_equal(drive[:, :joints], arriving * limits) and (drive[:, joints:] == 7.0).all()
    assert np.array_equal(asked, [actions[0], before[1]])
    assert efforts.tolist() == [pytest.approx(np.mean(actions[0] ** 2), rel=1e-15), 7.0]


def test_a_period_counts_for_who_has_not_failed():
    """Both may turn over energy: one that failed has the energies of its last good period."""
    rows, outputs, drive = np.zeros((2, 6)), np.zeros((2, layout.OUTPUTS)), np.full((2, 9), 3.0)
    outputs[:, layout.KINETIC], status = 5.0, np.array([layout.OK, layout.DIVERGED])
    periods, driven, turned = np.array([4.0, 4.0]), np.zeros((2, 9)), np.array([2.0, 8.0])
    close(rows, outputs, status, drive, periods, driven, turned)
    assert periods.tolist() == [5.0, 4.0] and driven[:, 0].tolist() == [3.0, 0.0] and turned.tolist() == [5.0, 8.0]


def test_an_episode_lasts_so_many_periods_that_its_arm_played():
    ages, over = np.array([1, 1, 2]), np.array([False, True, False])
    ended = [outlast(ages, np.array([True, False, True]), 3, over) for _ in range(2)]
    assert ages.tolist() == [3, 1, 4] and over.tolist() == [True, False, True] and ended == [1, 2]
