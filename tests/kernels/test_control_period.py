"""Operations of a control period: limits, observations, actions, episode length."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from flexman_gym.kernels import layout
from flexman_gym.kernels.control_period import (
    all_within,
    apply_actions,
    close_period,
    count_episode_periods,
    flag_violations,
    full_observation,
)
from flexman_gym.kernels.outputs import update_energy_turnover

LIMITS, BOUND = np.array([1.0, 2.0]), np.array([3.0])


@pytest.mark.parametrize(
    ("motion", "seen", "status", "flag"),
    [
        ([1.0, -2.0], [3.0], layout.OK, False),
        ([1.5, 0.0], [0.0], layout.OK, True),
        ([0.0, -2.5], [0.0], layout.OK, True),
        ([0.0, np.nan], [0.0], layout.OK, True),
        ([0.0, 0.0], [-3.5], layout.OK, True),
        ([0.0, 0.0], [np.nan], layout.OK, True),
        ([0.0, 0.0], [np.inf], layout.OK, True),
        ([0.0, 0.0], [0.0], layout.DIVERGED, True),
        ([0.0, 0.0], [0.0], layout.NOT_CONVERGED, True),
    ],
)
def test_an_arm_is_flagged_for_its_motion_its_observations_or_its_status(motion, seen, status, flag):
    """NaN violates every limit; the other arm is not affected."""
    flags, states = np.array([True, False]), np.array([layout.OK, status])
    count = flag_violations(np.array([[0.5, 0.5], motion]), LIMITS, np.array([[0.5], seen]), BOUND, states, flags)
    assert flags.tolist() == [False, flag] and count == flag


def test_the_full_observation_is_motion_errors_scaled_error_and_velocity():
    random, arms, joints = np.random.default_rng(0), 3, 2
    motion, angles, posture = (random.normal(size=(arms, width)) for width in (8 * joints + 3, joints, joints))
    velocity, error = random.normal(size=(2, arms, 3))
    lengths, out = np.linalg.norm(error, axis=1), np.zeros((arms, 9 * joints + 9))
    full_observation(motion, angles, velocity, posture, error, lengths, 0.1, out)
    nearness = error / (lengths[:, None] + 0.1)
    assert_array_equal(out, np.hstack([motion[:, :-3], posture - angles, error, nearness, velocity]))


def test_the_energy_scale_increases_and_keeps_nan():
    """The first of two arms becomes NaN on the way, in its energy, its work or its dissipation."""
    for place in range(3):
        result = np.zeros(2)
        for turnover, lost in ((3.0, False), (2.0, False), (5.0, True), (7.0, False), (4.0, False)):
            rows, out = np.zeros((2, 6)), np.zeros((2, layout.OUTPUTS))
            rows[:, -2], rows[:, -1], out[:, layout.KINETIC] = 0.5, -turnover, 1.0
            if lost:
                (out[0, layout.LINK_ENERGY : layout.LINK_ENERGY + 1], rows[0, -2:-1], rows[0, -1:])[place][:] = np.nan
            update_energy_turnover(rows, out, result)
        assert np.isnan(result[0]) and result[1] == 7.0


@pytest.mark.parametrize(("value", "inside"), [(1.0, True), (-1.0, True), (1.0 + 1e-15, False), (-2.0, False)])
def test_values_are_within_a_bound_they_reach(value, inside):
    assert all_within(np.array([0.5, value]), 1.0) == inside
    assert not all_within(np.array([value, np.nan]), 1.0)


def test_inactive_arms_keep_the_actions_requested_before():
    random, joints = np.random.default_rng(0), 3
    actions, arriving, before = random.uniform(-1.0, 1.0, (3, 2, joints))
    limits, drive, efforts = random.uniform(1.0, 9.0, (2, joints)), np.full((2, joints + 6), 7.0), np.full(2, 7.0)
    requested = before.copy()
    apply_actions(actions, arriving, limits, np.array([True, False]), drive, requested, efforts)
    assert np.array_equal(drive[:, :joints], arriving * limits) and (drive[:, joints:] == 7.0).all()
    assert np.array_equal(requested, [actions[0], before[1]])
    assert efforts.tolist() == [pytest.approx(np.mean(actions[0] ** 2), rel=1e-15), 7.0]


def test_a_period_counts_for_arms_that_have_not_failed():
    """The energy scale increases for both: a failed arm has the energies of its last valid period."""
    rows, outputs, drive = np.zeros((2, 6)), np.zeros((2, layout.OUTPUTS)), np.full((2, 9), 3.0)
    outputs[:, layout.KINETIC], status = 5.0, np.array([layout.OK, layout.DIVERGED])
    periods, driven, turnover = np.array([4.0, 4.0]), np.zeros((2, 9)), np.array([2.0, 8.0])
    close_period(rows, outputs, status, drive, periods, driven, turnover)
    assert periods.tolist() == [5.0, 4.0] and driven[:, 0].tolist() == [3.0, 0.0] and turnover.tolist() == [5.0, 8.0]


def test_an_episode_lasts_for_its_horizon_in_active_periods():
    periods, over = np.array([1, 1, 2]), np.array([False, True, False])
    ended = [count_episode_periods(periods, np.array([True, False, True]), 3, over) for _ in range(2)]
    assert periods.tolist() == [3, 1, 4] and over.tolist() == [True, False, True] and ended == [1, 2]
