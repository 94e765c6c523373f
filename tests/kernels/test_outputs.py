"""Outputs: what is read of arms beside their motion."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from flexman_gym.kernels import layout
from flexman_gym.kernels.outputs import turn_over
from flexman_gym.kernels.readings import beyond, read_everything

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
def test_an_arm_is_beyond_its_limits_or_what_its_sensors_can_say_or_has_failed(motion, seen, status, flag):
    """A number that is none is beyond all of them; the arm beside is not asked."""
    flags, states = np.array([True, False]), np.array([layout.OK, status])
    many = beyond(np.array([[0.5, 0.5], motion]), LIMITS, np.array([[0.5], seen]), BOUND, states, flags)
    assert flags.tolist() == [False, flag] and many == flag


def test_the_full_state_is_motion_errors_nearness_and_speed():
    random, arms, joints = np.random.default_rng(0), 3, 2
    motion, angles, posture = (random.normal(size=(arms, width)) for width in (8 * joints + 3, joints, joints))
    velocity, error = random.normal(size=(2, arms, 3))
    lengths, out = np.linalg.norm(error, axis=1), np.zeros((arms, 9 * joints + 9))
    read_everything(motion, angles, velocity, posture, error, lengths, 0.1, out)
    nearness = error / (lengths[:, None] + 0.1)
    assert_array_equal(out, np.hstack([motion[:, :-3], posture - angles, error, nearness, velocity]))


def test_what_is_turned_over_grows_and_a_number_that_is_none_stays():
    """Of two arms, the first of which loses its numbers on the way, in its energy, its work or its dissipation."""
    for place in range(3):
        result = np.zeros(2)
        for turned, lost in ((3.0, False), (2.0, False), (5.0, True), (7.0, False), (4.0, False)):
            rows, out = np.zeros((2, 6)), np.zeros((2, layout.OUTPUTS))
            rows[:, -2], rows[:, -1], out[:, layout.KINETIC] = 0.5, -turned, 1.0
            if lost:
                (out[0, layout.LINK_ENERGY : layout.LINK_ENERGY + 1], rows[0, -2:-1], rows[0, -1:])[place][:] = np.nan
            turn_over(rows, out, result)
        assert np.isnan(result[0]) and result[1] == 7.0
