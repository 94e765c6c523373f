"""Control: the PD controller as a formula, and on the arm."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import flexman_gym  # noqa: F401  registers the environments
from flexman_gym.control.pd import PD

SLICES = {"posture_errors": slice(0, 2), "motor_rates": slice(2, 4)}
numbers = st.floats(-10, 10)


@given(st.tuples(numbers, numbers, numbers, numbers))
def test_pd_is_linear_until_the_motors_saturate(values):
    observation = np.array(values)
    expected = np.array([100.0, 200.0]) * observation[:2] - np.array([10.0, 20.0]) * observation[2:]
    action = PD((100.0, 200.0), (10.0, 20.0), 400.0).act(observation, SLICES)
    assert action.dtype == np.float32
    np.testing.assert_allclose(action, np.clip(expected / 400.0, -1.0, 1.0), rtol=1e-6, atol=1e-7)


def test_pd_takes_energy_out_of_a_swinging_arm_that_is_already_at_its_posture():
    env = gym.make("FlexRRR-v0").unwrapped
    start = np.array([0.2, -0.3, 0.4])
    observation, _ = env.reset(seed=0, options={"start": start, "posture": start})
    pd = PD((811.0, 369.0, 2972.0), (854.0, 384.0, 349.0), env.torque_limit)
    for _ in range(25):
        observation, *_ = env.step(np.array([0.5, -0.5, 0.5], dtype=np.float32))
    disturbed = env.simulator.energy
    for _ in range(200):
        observation, *_ = env.step(pd.act(observation, env.sensors.slices))
    assert env.simulator.energy < 0.5 * disturbed


@pytest.mark.parametrize(
    "arguments, field",
    [
        (((-1.0,), (1.0,), 400.0), "PD.stiffness[0]: -1.0 is not allowed; give a finite number >= 0"),
        (((1.0,), (float("nan"),), 400.0), "PD.damping[0]: nan is not allowed; give a finite number"),
        (((1.0,), (1.0, 2.0), 400.0), "PD.damping: (1.0, 2.0) is not allowed; give 1 numbers"),
        (((1.0,), (1.0,), 0.0), "PD.torque_limit: 0.0 is not allowed; give a finite number > 0"),
    ],
)
def test_bad_gains_are_named(arguments, field):
    with pytest.raises(ValueError) as caught:
        PD(*arguments)
    assert field in str(caught.value)
    assert "\n" not in str(caught.value)
