"""Residual vibration and damping ratios of sines and decays with known values."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexman_gym.metrics import damping_ratio, peak_to_peak, remaining_energy, residual_vibration

from oracles.assertions import refusal

PERIOD = 0.02
TIME = PERIOD * np.arange(501)  # 10 s


@pytest.mark.slow
@given(st.floats(0.001, 1.0), st.integers(1, 5), st.integers(0, 2))
def test_peak_to_peak_of_a_sine_is_twice_its_amplitude_along_its_axis(amplitude, frequency, axis):
    """Whole periods in the last 3 s, after a large motion; the sum over two axes would be larger."""
    tips = np.zeros((501, 3))
    tips[:, axis] = 7.0 + amplitude * np.cos(2 * np.pi * frequency * TIME)
    tips[:, axis - 1] = 0.5 * amplitude * np.sin(2 * np.pi * frequency * TIME)
    tips[:349] = -5.0
    peak = abs(np.cos(2 * np.pi * frequency * TIME[350:])).max()
    low = np.cos(2 * np.pi * frequency * TIME[350:]).min()
    assert peak_to_peak(tips, PERIOD) == pytest.approx(amplitude * (peak - low), rel=1e-9)
    assert peak_to_peak(tips, PERIOD) == pytest.approx(2 * amplitude, rel=0.03)


def test_peak_to_peak_takes_the_window_with_both_ends_and_what_there_is():
    tips = np.zeros((501, 3))
    tips[350, 1] = 0.3  # exactly 3 s before the end
    assert peak_to_peak(tips, PERIOD) == 0.3
    tips[350, 1], tips[349, 1] = 0.0, 0.3
    assert peak_to_peak(tips, PERIOD) == 0.0 and peak_to_peak(tips, PERIOD, 3.02) == 0.3
    assert peak_to_peak(np.array([[0.0, 0, 0], [0, 0, 1]]), PERIOD) == 1.0


def swinging(amplitude, end, axis=1, period=PERIOD):
    """Tips (T, 3) that are slewed by 2 m until an end (s) and swing at 1 Hz from there on."""
    time = period * np.arange(501)
    tips = np.zeros((501, 3))
    tips[:, 0] = np.minimum(2.0 * time / end, 2.0)
    tips[:, axis] += np.where(time >= end - 1e-9, amplitude * np.sin(2 * np.pi * (time - end)), 0.0)
    return tips


@given(st.floats(1e-3, 0.2), st.sampled_from([1.0, 2.5, 4.0]), st.sampled_from([1.0, 2.5, 4.0]), st.integers(0, 2))
def test_residual_vibration_is_the_ratio_of_the_amplitudes_whenever_the_commands_ended(part, end, other, axis):
    """The much larger slews are excluded."""
    result = residual_vibration(swinging(0.1 * part, end, axis), swinging(0.1, other), PERIOD, end, other)
    assert result == pytest.approx(100.0 * part, rel=1e-6)


def test_residual_vibration_of_a_run_and_itself_is_100_percent_and_of_a_still_tip_0():
    unshaped = swinging(0.1, 2.0)
    assert residual_vibration(unshaped, unshaped, PERIOD, 2.0) == 100.0
    assert residual_vibration(swinging(0.0, 3.0), unshaped, PERIOD, 3.0, 2.0) == 0.0


def test_both_runs_are_looked_at_for_the_same_time():
    """From the sample at the end of the command; the vibration of one run grows after the end of the other record."""
    late, early = swinging(0.1, 6.0), swinging(0.1, 2.0)
    early[301:, 1] = 5.0  # 4 s after its end, and a sample
    assert residual_vibration(late, early, PERIOD, 6.0, 2.0) == pytest.approx(100.0)
    assert residual_vibration(early, late, PERIOD, 2.0, 6.0) == pytest.approx(100.0)
    for place, seen in ((300, True), (100, True), (99, False)):
        other = swinging(0.1, 2.0)
        other[place, 1] = 4.9
        assert (residual_vibration(late, other, PERIOD, 6.0, 2.0) < 5.0) == seen


def decay(ratio, count=2001, samples=20, phase=0.3, place=0.0):
    """Free decay of a mode with a number of samples per cycle, and an offset."""
    angle = 2 * np.pi / samples * np.arange(count)  # of the damped frequency
    return place + np.exp(-ratio / np.sqrt(1 - ratio**2) * angle) * np.cos(angle + phase)


@pytest.mark.slow
@given(
    st.floats(0.002, 0.3), st.floats(20.0, 200.0), st.floats(0.0, 6.28), st.floats(-10.0, 10.0), st.floats(1e-6, 1e3)
)
def test_the_damping_ratio_of_one_mode_is_found_wherever_it_rests(ratio, samples, phase, place, scale):
    result = damping_ratio(scale * decay(ratio, 4001, samples, phase, place))
    assert result == pytest.approx(ratio, abs=1e-4 + 2e-3 * ratio)


def test_many_samples_bring_the_damping_ratio_as_close_as_is_wanted():
    """For any phase of the samples in the cycle."""
    errors = []
    for samples in (20.3, 40.6, 81.2, 162.4):
        result = [damping_ratio(decay(0.05, int(20 * samples), samples, phase)) for phase in np.linspace(0.0, 6.0, 20)]
        errors.append(np.abs(np.array(result) - 0.05).max())
    assert errors[0] < 1e-4 and errors[-1] < 1e-7 and (np.divide(errors[:-1], errors[1:]) > 4.0).all()


def test_noise_does_not_count_as_swings():
    noise = np.random.default_rng(0).normal(size=4001)
    assert damping_ratio(decay(0.01, 4001, 100) + 0.005 * noise) == pytest.approx(0.01, rel=0.03)


def test_of_two_modes_the_one_that_makes_the_turning_points_counts():
    """A second mode of a fiftieth of the size, damped or undamped, has no influence; two equal modes both have."""
    slow = decay(0.02, 4001, 200)
    ripple = decay(0.0, 4001, 33) / 50
    assert damping_ratio(slow + ripple) == pytest.approx(0.02, rel=0.05)
    alike = slow + decay(0.06, 4001, 170)
    assert 0.02 < damping_ratio(alike) < 0.06


def test_a_steady_vibration_has_no_damping_and_a_growing_one_a_negative_ratio():
    assert damping_ratio(decay(0.0)) == pytest.approx(0.0, abs=1e-5)
    assert damping_ratio(decay(0.01, 501)[::-1]) == pytest.approx(-0.01, rel=1e-2)


ONCE = np.sin(0.2 * np.pi * TIME)  # one cycle: two turning points
STILL = (np.ones(9), np.arange(9.0), np.exp(-TIME), np.r_[0.0, 1.0, 0.0], np.abs(TIME - 5.0), ONCE)


@pytest.mark.parametrize("signal", STILL)
def test_what_does_not_vibrate_has_no_damping_ratio(signal):
    assert np.isnan(damping_ratio(signal))


def test_the_energy_left_is_the_part_of_the_largest_or_of_the_first():
    energies = np.array([2.0, 8.0, 0.5, 1.0])
    assert remaining_energy(energies) == 1 / 8 and remaining_energy(energies, reference="first") == 1 / 2
    assert remaining_energy(np.array([3.0])) == 1.0 and remaining_energy(np.array([1.0, 0.0])) == 0.0


@given(st.floats(0.001, 0.1), st.floats(0.5, 5.0))
def test_the_energy_of_a_damped_mode_falls_by_twice_its_rate(ratio, frequency):
    rate = 2 * np.pi * frequency * ratio
    assert remaining_energy(7.0 * np.exp(-2 * rate * TIME)) == pytest.approx(np.exp(-20.0 * rate))


NINE = np.zeros((9, 3))


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: peak_to_peak(np.zeros(9), 0.1), "tips: array([0., 0., 0., 0., 0., 0., 0., 0., 0.]) is not allowed"),
        (lambda: peak_to_peak(NINE, 0.1, 0.0), "window: 0.0 is not allowed; give a finite number > 0 (s)"),
        (lambda: residual_vibration(NINE, NINE, 0.1, 0.2), "unshaped: array([[0., 0., 0.], [0., 0., 0.], "),
        (lambda: residual_vibration(NINE, NINE, 0.1, 0.8), "end: 0.8 is not allowed; give a time (s) of at most 0.7"),
        (lambda: residual_vibration(NINE, NINE, 0.1, 0.2, 9), "unshaped_end: 9 is not allowed; give a time (s) of at"),
        (lambda: residual_vibration(NINE, NINE, 0.1, -1.0), "end: -1.0 is not allowed; give a finite number >= 0 (s)"),
        (lambda: residual_vibration(NINE, NINE, 0.0, 0.2), "period: 0.0 is not allowed; give a finite number > 0 (s)"),
        (lambda: residual_vibration(NINE + np.inf, NINE, 0.1, 0.2), "tips: array([[inf, inf, inf], [inf, inf, inf],"),
        (lambda: damping_ratio(np.zeros(2)), "signal: array([0., 0.]) is not allowed; give at least 3 samples"),
        (lambda: damping_ratio(np.full(3, np.nan)), "signal: array([nan, nan, nan]) is not allowed; give finite numb"),
        (lambda: damping_ratio(NINE), "signal: array([[0., 0., 0.], "),
        (
            lambda: remaining_energy(np.zeros(3)),
            "energies: array([0., 0., 0.]) is not allowed; give numbers >= 0 (J), of",
        ),
        (
            lambda: remaining_energy(np.array([0.0, 1.0]), "first"),
            "energies: array([0., 1.]) is not allowed; give numbers",
        ),
        (
            lambda: remaining_energy(np.array([1.0, -1.0])),
            "energies: array([ 1., -1.]) is not allowed; give numbers >= 0",
        ),
        (lambda: remaining_energy(np.ones(3), "last"), "reference: 'last' is not allowed; give one of largest, first"),
    ],
)
def test_bad_arrays_and_times_are_refused_in_one_line(call, line):
    assert refusal(call).startswith(line)
