"""Records of `Ringing.estimate` with faults: undamped tones and readings at the limit of a sensor."""

import re
import warnings

import numpy as np
import pytest

import flexman_gym as fm

from oracles.assertions import refusal

COUNT = 2000


def decay(times, frequency, ratio):
    """Return a free vibration of a damped frequency (Hz)."""
    return np.exp(-2.0 * np.pi * frequency * ratio / np.sqrt(1.0 - ratio**2) * times) * np.cos(
        2.0 * np.pi * frequency * times + 0.4
    )


def noise(scale, seed=0):
    return scale * np.random.default_rng(seed).standard_normal(COUNT)


@pytest.mark.parametrize("frequency", [0.5, 40.0])
@pytest.mark.parametrize("harmonics", [(), (2, 3)])
def test_tone_of_a_motor_is_refused_as_no_decay(frequency, harmonics):
    times = np.arange(COUNT) / (20.0 * frequency)
    values = sum(np.sin(2.0 * np.pi * frequency * k * times) / k for k in (1, *harmonics)) + noise(0.01)
    assert re.match(r"ringing: '\S+ Hz with a damping ratio of \S+ \+- \S+' is not allowed; give a record that proves",
                    refusal(fm.Ringing.estimate, times, values))  # fmt: skip


def test_tone_beside_a_decaying_vibration_is_left_out_with_a_warning():
    times = 0.002 * np.arange(COUNT)
    values = decay(times, 7.0, 0.03) + 0.5 * np.sin(2.0 * np.pi * 40.0 * times) + noise(0.005)
    with pytest.warns(UserWarning, match=r"ringing: 40 Hz with a damping ratio of .* does not decay and is left out"):
        found = fm.Ringing.estimate(times, values)
    assert found.frequencies == pytest.approx([7.0], rel=2e-3) and found.damping == pytest.approx([0.03], rel=0.05)


@pytest.mark.parametrize("level", [0.3, 0.6, 0.8])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("ratio", [0.02, 0.09])
def test_readings_at_the_limit_of_a_sensor_are_left_out_and_keep_the_damping(level, sign, ratio):
    times = 0.0005 * np.arange(COUNT)
    exact = sign * decay(times, 21.0, ratio)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = fm.Ringing.estimate(times, np.clip(exact + noise(0.002), -level, level))
    assert any("the last one at a limit of the sensor, are left out" in str(each.message) for each in caught)
    assert found.frequencies == pytest.approx([21.0], rel=1e-3)
    assert found.damping == pytest.approx([ratio], rel=0.03)


def test_record_within_the_limits_of_the_sensor_has_no_warning():
    times = 0.0005 * np.arange(COUNT)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fm.Ringing.estimate(times, decay(times, 21.0, 0.05) + noise(0.002))


def test_record_at_the_limit_of_the_sensor_to_its_end_is_refused():
    times = 0.002 * np.arange(COUNT)
    values = np.clip(decay(times, 100.0 / 3.0, 0.0), -0.2, 0.2)
    with pytest.warns(UserWarning, match="limit of the sensor"):
        line = refusal(fm.Ringing.estimate, times, values)
    assert re.match(r"ringing: '\d+ readings after the last one at a limit' is not allowed; give 16 or more", line)
