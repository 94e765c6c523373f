"""Friction of motors: torque, slope, and mean over a period; equality with the kernels."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.model.friction import (
    coulomb_slopes,
    coulomb_torques,
    friction_torques,
    mean_friction_derivatives,
    mean_friction_torques,
)

from oracles.frictional import two_links as model

RATES = st.floats(-8.0, 8.0)


def sticking():
    """Rigid arm with static friction beyond its Coulomb friction."""
    arm = model().arm
    joints = [replace(each, static_friction=0.9, stribeck_rate=0.4) for each in arm.joints]
    return fm.build_model(replace(arm, joints=joints), flexible_links=False, flexible_joints=False)


@pytest.mark.slow
@given(first=RATES, second=RATES)
def test_torques_equal_those_of_the_kernels(first, second):
    own, rates = sticking(), np.array([first, second])
    state = np.concatenate([[0.3, -0.2], rates])
    smooth = replace(own, constants=own.constants._replace(
        rotor_damping=np.zeros(2), coulomb_friction=np.zeros(2), has_coulomb_friction=np.zeros(2, dtype=np.int64)
    ))  # fmt: skip
    change = fm.acceleration(smooth, state, np.zeros(2)) - fm.acceleration(own, state, np.zeros(2))
    expected = own.constants.rotor_damping * rates + coulomb_torques(own, rates)
    assert fm.mass_matrix(own, state) @ change == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("rate", [0.0, 0.02, -0.1, 0.5, -3.0])
def test_slopes_equal_extrapolated_differences_of_the_torques(rate):
    own = sticking()
    coarse, fine = (
        (coulomb_torques(own, np.full(2, rate + step)) - coulomb_torques(own, np.full(2, rate - step))) / (2.0 * step)
        for step in (2e-4, 1e-4)
    )
    assert coulomb_slopes(own, np.full(2, rate)) == pytest.approx((4.0 * fine - coarse) / 3.0, rel=1e-6, abs=1e-9)


@example(before=0.0, after=1e-5, width=1e-3)
@given(before=RATES, after=RATES, width=st.floats(1e-3, 0.1))
def test_the_mean_friction_is_that_over_a_uniform_change_of_the_rate(before, after, width):
    coefficients = np.array([[0.4], [1.5]])
    knots = np.unique(np.clip(width * np.linspace(-40.0, 40.0, 4001), *sorted((before, after))))
    rates = np.unique(np.concatenate([[before, after], knots]))
    values, middle = 0.4 * rates + 1.5 * np.tanh(rates / width), 0.5 * (before + after)
    at_middle = 0.4 * middle + 1.5 * np.tanh(middle / width)  # the mean over a change that is small beside the width
    mean = np.trapezoid(values, rates) / np.ptp(rates) if np.ptp(rates) > 1e-5 else at_middle
    found = mean_friction_torques(coefficients, np.array([before]), np.array([after]), width)
    assert found == pytest.approx(mean, abs=1e-3)


@pytest.mark.parametrize("change", [0.0, 1e-4, 4e-3, 6e-3, 0.3, -2.0])
def test_derivatives_of_the_mean_friction_are_those_of_extrapolated_differences(change):
    """Below a hundredth of the width of the smoothed friction, 0.5 rad/s, they follow from a quadrature."""
    coefficients, width, first = np.array([[0.3], [2.0]]), np.array([0.5]), 0.4

    def torque(by_first, by_last):
        return mean_friction_torques(coefficients, first + by_first, first + change + by_last, width)

    def differences(step, unit):
        return (torque(*step * unit) - torque(*-step * unit)) / (2.0 * step)

    changes = np.array([[1.0, 0.0], [0.0, 1.0]])
    rates = (np.array([[first]]), changes[:, :1]), (np.array([[first + change]]), changes[:, 1:])
    exact = mean_friction_derivatives(coefficients, *rates, width)
    for unit, value in zip(changes, exact, strict=True):
        coarse, middle, fine = (differences(step, unit) for step in (0.04, 0.02, 0.01))
        best = (16.0 * (4.0 * fine - middle) - (4.0 * middle - coarse)) / 45.0
        np.testing.assert_allclose(value, best, rtol=1e-6)


def test_the_mean_over_a_change_of_sign_does_not_drive_a_motor_and_at_equal_rates_it_is_the_friction():
    own, c = model(viscous=0.0), np.array([[0.0, 0.0], [0.6, 0.6]])
    width, rate = own.constants.coulomb_rate, np.array([0.2, -0.01])
    assert mean_friction_torques(c, rate, -rate, width) == pytest.approx(0.0, abs=1e-12)
    assert mean_friction_torques(c, rate, rate, width) == pytest.approx(friction_torques(own, rate, c), rel=1e-12)
    assert mean_friction_torques(c, rate, rate + 2e-6, width) == pytest.approx(
        friction_torques(own, rate + 1e-6, c), rel=1e-6
    )
