"""Measured: what follows from measurements is as uncertain as they are."""

import numpy as np
import pytest

from flexman_gym.envs.env import FlexManEnv

STILL = {"start": [0.3, 0.4, -0.5], "goal_angles": [0.3, 0.4, -0.5]}


def test_what_is_derived_is_as_uncertain_as_what_is_measured():
    """Nearness, error and the fine scale all tell of one tip, which noise has moved by centimetres."""
    env = FlexManEnv(sensors=("full", "fine"), randomisation={"sensor_noise": (0.002, 0.002)})
    observation, info = env.reset(seed=3, options=STILL)
    off = []
    for _ in range(100):
        parts = {name: observation[place].astype(float) for name, place in env.sensors.slices.items()}
        error = parts["target_error"]
        near = parts["target_nearness"]
        assert near == pytest.approx(error / (0.1 + np.sqrt(error @ error)), rel=1e-5, abs=1e-6)
        assert np.sinh(parts["fine_target_error"]) * 8.5 / 425 == pytest.approx(error, rel=1e-4, abs=1e-6)
        assert parts["angle_errors"] == pytest.approx(info["goal_angles"] - parts["motor_angles"], abs=1e-5)
        off.append(error - (info["target"] - info["tip"]))
        observation, _, _, _, info = env.step(np.zeros(3))
    spread = 0.002 * 1.25 * 8.5  # of the tip's range
    assert np.std(off) == pytest.approx(spread, rel=0.15)
