"""Root mean squares and the integral of squared accelerations against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexman_gym.metrics import rms, squared_acceleration

from oracles.assertions import refusal


@given(st.floats(1e-3, 1e3), st.integers(1, 20))
def test_the_rms_of_whole_periods_of_a_sine_is_its_amplitude_over_root_two(amplitude, cycles):
    sine = amplitude * np.sin(2 * np.pi * cycles / 100 * np.arange(100))
    assert rms(sine) == pytest.approx(amplitude / np.sqrt(2))


def test_the_rms_of_vectors_is_that_of_their_lengths():
    """For a circle the radius, unlike a mean over all entries."""
    angle = np.linspace(0.0, 5.0, 77)
    assert rms(3.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])) == pytest.approx(3.0)
    assert rms(np.array([[3.0, 4.0]])) == 5.0 and rms(np.array([-2.0])) == 2.0


def test_the_rms_is_that_of_mean_and_spread():
    values = np.random.default_rng(0).normal(3.0, 2.0, 1000)
    assert rms(values) ** 2 == pytest.approx(values.mean() ** 2 + values.var())


def test_the_squared_acceleration_is_an_integral_whatever_the_period():
    """Of 3 m/s^2 for 2 s: 18 m^2/s^3. Of a minimum-acceleration move it is 12 distance^2 / time^3."""
    for samples in (2, 21, 2001):
        period = 2.0 / (samples - 1)
        assert squared_acceleration(np.full(samples, 3.0), period) == pytest.approx(18.0)
        assert squared_acceleration(np.tile([1.0, -2.0, 2.0], (samples, 1)), period) == pytest.approx(18.0)
    time = np.linspace(0.0, 0.5, 5001)
    move = 6.0 * 1.5 / 0.5**2 * (1.0 - 2.0 * time / 0.5)
    assert squared_acceleration(move, 1e-4) == pytest.approx(12.0 * 1.5**2 / 0.5**3, rel=1e-6)


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: rms(np.zeros(0)), "values: array([], dtype=float64) is not allowed; give an array of 1 or 2 axes"),
        (lambda: rms(np.zeros((2, 0))), "values: array([], shape=(2, 0), dtype=float64) is not allowed"),
        (lambda: rms(np.zeros((1, 1, 1))), "values: array([[[0.]]]) is not allowed; give an array of 1 or 2 axes"),
        (lambda: rms(np.array([np.inf])), "values: array([inf]) is not allowed; give finite numbers"),
        (lambda: squared_acceleration(np.zeros(1), 0.1), "accelerations: array([0.]) is not allowed; give at least 2"),
        (lambda: squared_acceleration(np.zeros(2), -0.1), "period: -0.1 is not allowed; give a finite number > 0 (s)"),
    ],
)
def test_bad_arrays_and_times_are_refused_in_one_line(call, line):
    assert refusal(call).startswith(line)
