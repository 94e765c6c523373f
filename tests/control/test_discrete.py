"""Discrete: the sampled model is the exact solution, and the gain is the best there is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import flexman_gym as fm
from flexman_gym.control.discrete import Weights, optimal_gain, zero_order_hold
from flexman_gym.model.state_space import LinearModel

from oracles.chains import QUICK, samples
from oracles.refusals import refusal

PERIOD = 0.02


def linear_model(A, B, C):
    """A linear model of plain matrices."""
    return LinearModel(np.array(A), np.array(B), np.array(C), np.zeros((len(C), len(B[0]))))


def double_integrator(inertia, length=1.0):
    """A rigid link on a motor: angle and rate, moved by a torque; its tip moves along y."""
    return linear_model([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1 / inertia]], [[0, 0], [length, 0], [0, 0]])


@given(st.floats(1e-3, 10.0), st.floats(1e-3, 1.0))
def test_a_sampled_double_integrator_is_its_closed_form(inertia, period):
    transition, inputs = zero_order_hold(double_integrator(inertia), period)
    assert transition == pytest.approx(np.array([[1.0, period], [0.0, 1.0]]), rel=1e-12)
    assert inputs == pytest.approx(np.array([[period**2 / 2], [period]]) / inertia, rel=1e-12)


def test_the_transition_is_the_finely_integrated_solution():
    """Of a flexible arm in a bent posture under gravity, from a random state with constant torques."""
    model = fm.build_model(fm.catalog.vertical_2r(), 1, 2)
    posture, rng = np.array([0.4, -0.7]), np.random.default_rng(0)
    held = fm.holding_torques(model, posture)
    linear = fm.linearize(model, state=fm.rest_state(model, posture), torque=held)
    x, torque = rng.standard_normal(2 * model.n_dof), rng.standard_normal(2)
    transition, inputs = zero_order_hold(linear, PERIOD)

    def rate(time, state):
        return linear.A @ state + linear.B @ torque

    result = solve_ivp(rate, (0.0, PERIOD), x, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    assert np.abs(transition @ x + inputs @ torque - result).max() <= 1e-8 * np.abs(result).max()


@settings(QUICK, max_examples=10)
@given(samples(most_links=2, flexible_joints=True), st.floats(1e-4, 1e-3))
def test_two_half_periods_are_a_period(sample, period):
    linear = fm.linearize(sample.model)
    whole, half = zero_order_hold(linear, period), zero_order_hold(linear, period / 2)
    for result, expected in zip(whole, (half[0] @ half[0], half[0] @ half[1] + half[1]), strict=True):
        assert np.abs(result - expected).max() <= 1e-8 * np.abs(expected).max()


@given(st.floats(0.2, 3.0), st.floats(0.1, 100.0), st.floats(0.05, 5.0))
def test_the_gain_of_a_scalar_is_the_root_of_its_quadratic_equation(fall, limit, speed):
    """Only the rate is moved: p = q + a^2 p - (a b p)^2 / (r + b^2 p), so k = a b p / (r + b^2 p)."""
    linear = linear_model([[-1.0, 0.0], [0.0, -fall]], [[0.0], [2.0]], [[0, 0], [1, 0], [0, 0]])
    weights = Weights(tip=1.0, tip_speed=speed, motor=1.0)
    gain = optimal_gain(linear, np.array([0]), np.array([limit]), weights, 0.1)
    a, b = np.exp(-0.1 * fall), 2.0 * (1 - np.exp(-0.1 * fall)) / fall
    q, r = 1 / speed**2, 1 / limit**2
    half = (r - a * a * r - b * b * q) / (2 * b * b)
    p = -half + np.sqrt(half**2 + q * r / b**2)
    assert gain == pytest.approx(np.array([[0.0, a * b * p / (r + b * b * p)]]), rel=1e-7, abs=1e-9)


def cost(linear, gain, weights, limit, x):
    """The cost of an episode from x, by its definition."""
    transition, inputs = zero_order_hold(linear, PERIOD)
    total = 0.0
    for _ in range(3000):
        torque = -gain @ x
        tip, speed = linear.C[:, : len(x) // 2] @ x[: len(x) // 2], linear.C[:, : len(x) // 2] @ x[len(x) // 2 :]
        total += tip @ tip / weights.tip**2 + speed @ speed / weights.tip_speed**2
        total += (x[0] / weights.motor) ** 2 + (torque @ torque) / limit**2
        x = transition @ x + inputs @ torque
    return total


def test_no_gain_nearby_costs_less():
    linear, weights, limit = double_integrator(0.5, 2.0), Weights(0.2, 1.0, 0.5), 3.0
    gain = optimal_gain(linear, np.array([0]), np.array([limit]), weights, PERIOD)
    x = np.array([1.0, -0.5])
    best = cost(linear, gain, weights, limit, x)
    for change in ([0.03, 0.0], [-0.03, 0.0], [0.0, 0.03], [0.0, -0.03]):
        assert cost(linear, gain * (1 + np.array(change)), weights, limit, x) > best * (1 + 1e-6)


def test_the_angle_of_a_motor_weighs_wherever_it_stands_in_the_state():
    """Beside a coordinate that nothing moves, which comes to rest by itself, its gain is that of the motor alone."""
    weights, limit = Weights(0.2, 1.0, 0.5), np.array([3.0])
    alone = optimal_gain(double_integrator(0.5, 0.0), np.array([0]), limit, weights, PERIOD)
    A = [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [-9.0, 0.0, -3.0, 0.0], [0.0, 0.0, 0.0, 0.0]]
    beside = linear_model(A, [[0.0], [0.0], [0.0], [1 / 0.5]], np.zeros((3, 2)))
    gain = optimal_gain(beside, np.array([1]), limit, weights, PERIOD)
    assert gain[:, [1, 3]] == pytest.approx(alone, rel=1e-8) and gain[:, [0, 2]] == pytest.approx(0.0, abs=1e-9)


def test_units_of_torque_do_not_matter():
    """Inertia and limits a thousand times as large ask for a thousand times the torque."""
    weights = Weights(0.2, 1.0, 0.5)
    one, many = (
        optimal_gain(double_integrator(scale), np.array([0]), np.array([3.0 * scale]), weights, PERIOD)
        for scale in (1.0, 1000.0)
    )
    assert many == pytest.approx(1000.0 * one, rel=1e-8)


def test_a_period_that_is_none_is_refused():
    line = refusal(zero_order_hold, double_integrator(1.0), 0.0)
    assert line == "period: 0.0 is not allowed; give a finite number > 0 (s)"
