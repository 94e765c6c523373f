"""Readings that are no samples of a vibration: rounding, repetitions and crowded extremes."""

import numpy as np
import pytest

from flexman_gym.toolbox.identification.readings import crowded_extremes, repeated_readings, rounding_step

TIMES = 0.01 * np.arange(1000)
EXACT = np.exp(-0.3 * TIMES) * np.cos(20.0 * TIMES)


def rounded(values, step):
    return step * np.round(values / step) if step else values


@pytest.mark.parametrize("step", [1e-6, 0.003, 0.1])
def test_rounding_step_is_that_of_the_converter_with_an_offset(step):
    assert rounding_step(0.37 + rounded(EXACT, step)) == pytest.approx(step, rel=1e-6)


def test_exact_readings_have_no_rounding_step():
    assert rounding_step(EXACT) == 0.0 == rounding_step(np.ones(20))


@pytest.mark.parametrize("step", [0.0, 0.01, 0.2])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_rounding_alone_makes_no_repeated_readings(step, noise):
    assert not repeated_readings(rounded(EXACT + noise * np.random.default_rng(0).standard_normal(1000), step)).any()


@pytest.mark.parametrize("factor", [2, 3, 5])
@pytest.mark.parametrize("step", [0.0, 0.01])
def test_readings_of_a_sensor_slower_than_the_log_are_repeated(factor, step):
    held = rounded(EXACT, step)[np.arange(1000) // factor * factor]
    repeated, old = repeated_readings(held), np.arange(1000) % factor > 0
    assert repeated[~old].mean() < (0.1 if step else 1e-9)  # a rounded reading may equal the one before
    early = np.arange(1000) < 300  # later the rounded vibration changes by less than STEEP steps
    assert repeated[early & old].mean() > 0.9


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_crowded_extremes_are_those_of_a_clipped_vibration(noise):
    clipped = np.clip(EXACT, -0.6, 2.0) + noise * np.random.default_rng(1).standard_normal(1000)
    found = crowded_extremes(clipped)
    assert (found[EXACT < -0.6] == -1.0).mean() > 0.9 and not found[EXACT > -0.55].any()


@pytest.mark.parametrize("rate", [0.0, 0.3])
def test_extremes_of_a_sinusoid_are_not_crowded(rate):
    assert not crowded_extremes(np.exp(-rate * TIMES) * np.cos(20.0 * TIMES)).any()
