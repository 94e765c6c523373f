"""Effort and high-frequency power of sinusoidal actions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import periodogram

from flexman_gym.metrics import effort, high_frequency_power

from oracles.assertions import refusal

PERIOD = 0.02
TIME = PERIOD * np.arange(501)  # 10 s


def test_effort_is_the_mean_square_of_all_actions():
    assert effort(np.array([[1.0, 0.0], [0.0, -1.0]])) == 0.5
    assert effort(np.full((7, 3), -0.5)) == 0.25


def sine(frequency, phase=0.0, amplitude=1.0, place=0.0, time=TIME):
    """Sinusoidal actions (T, 1) with an offset."""
    return place + amplitude * np.sin(2 * np.pi * frequency * time + phase)[:, None]


@pytest.mark.slow
@given(st.floats(0.3, 1.6), st.floats(0.0, 6.28), st.floats(-5.0, 5.0), st.sampled_from([200, 333, 501]))
def test_a_sine_below_the_frequency_has_no_power_above_and_one_above_has_all(frequency, phase, place, count):
    """For any number of cycles and any offset."""
    assert high_frequency_power(sine(frequency, phase, 1.0, place)[-count:], PERIOD, 4.0) < 2e-3
    assert high_frequency_power(sine(frequency + 7.0, phase, 1.0, place)[-count:], PERIOD, 4.0) > 1 - 2e-3
    assert high_frequency_power(sine(24.5, phase, 1.0, place)[-count:], PERIOD, 4.0) > 1 - 2e-3


@given(st.floats(0.1, 10.0), st.floats(0.0, 6.28))
def test_of_two_sines_each_has_the_part_of_its_squared_amplitude(ratio, phase):
    """In one motor or in two."""
    slow, quick = sine(1.0), sine(9.0, phase, ratio)
    expected = ratio**2 / (1.0 + ratio**2)
    assert high_frequency_power(slow + quick, PERIOD, 4.0) == pytest.approx(expected, rel=1e-3)
    assert high_frequency_power(np.hstack([slow, quick]), PERIOD, 4.0) == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("count", [4000, 4001])
def test_white_noise_has_the_part_of_the_band_that_lies_above(count):
    noise = np.random.default_rng(0).normal(size=(count, 30))
    for part in (0.1, 0.5, 0.9):
        assert high_frequency_power(noise, PERIOD, part * 25.0) == pytest.approx(1.0 - part, abs=0.01)


@pytest.mark.parametrize("count", [60, 61])
def test_it_is_the_part_of_the_periodogram_of_scipy(count):
    actions = np.random.default_rng(1).normal(1.0, 2.0, (count, 3))
    frequencies, power = periodogram(actions, 1.0 / PERIOD, "hann", detrend="constant", axis=0)
    for frequency in (4.0, 12.5, 24.0):
        expected = power[frequencies > frequency].sum() / power.sum()
        assert high_frequency_power(actions, PERIOD, frequency) == pytest.approx(expected, rel=1e-12)


def test_the_sample_to_sample_flicker_of_a_bang_bang_controller_is_all_above():
    flicker = np.where(np.arange(500) % 2, 1.0, -1.0)[:, None]
    assert high_frequency_power(flicker, PERIOD, 24.0) == pytest.approx(1.0)


@pytest.mark.parametrize("value", [0.0, 0.1, -1e6])
def test_constant_actions_have_no_power_above(value):
    assert high_frequency_power(np.full((501, 3), value), PERIOD, 4.0) == 0.0


def test_the_part_does_not_depend_on_the_unit_of_the_actions():
    actions = sine(1.0) + sine(9.0)
    for scale in (1e-9, 1e9):
        assert high_frequency_power(scale * actions, PERIOD, 4.0) == pytest.approx(
            high_frequency_power(actions, PERIOD, 4.0), rel=1e-12
        )


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: effort(np.zeros((0, 3))), "actions: array([], shape=(0, 3), dtype=float64) is not allowed; give an"),
        (
            lambda: high_frequency_power(np.zeros(9), 0.1, 1.0),
            "actions: array([0., 0., 0., 0., 0., 0., 0., 0., 0.]) is not all",
        ),
        (lambda: high_frequency_power(np.zeros((39, 1)), 0.1, 1.0), "actions: array([[0.], [0.], [0.], [0.], [0.], "),
        (lambda: high_frequency_power(np.full((99, 1), np.nan), 0.1, 1.0), "actions: array([[nan], [nan], [nan], "),
        (
            lambda: high_frequency_power(np.zeros((99, 1)), 0.1, 5.0),
            "frequency: 5.0 is not allowed; give a number > 0 and < 5",
        ),
        (
            lambda: high_frequency_power(np.zeros((99, 1)), 0.1, 0.0),
            "frequency: 0.0 is not allowed; give a finite number > 0",
        ),
        (
            lambda: high_frequency_power(np.zeros((99, 1)), 0.0, 1.0),
            "period: 0.0 is not allowed; give a finite number > 0 (s)",
        ),
    ],
)
def test_bad_arrays_and_times_are_refused_in_one_line(call, line):
    assert refusal(call).startswith(line)


def test_four_cycles_are_enough():
    assert high_frequency_power(sine(0.1)[:40], 0.1, 1.0) == pytest.approx(0.0, abs=1e-2)
