"""Modes of records of free vibration: tones, limits of sensors, repeated readings, columns, and intervals."""

import re
import warnings

import numpy as np
import pytest
from scipy.signal import lsim, lti

import flexman_gym as fm

from oracles.assertions import refusal
from oracles.free_vibrations import KINDS, decay, made_record

TIMES = 0.002 * np.arange(2000)
COVERED = 1.96  # half width of an interval / standard deviation; 95 % of a normal distribution
SAME = 0.05  # relative difference of the frequencies of a found mode and a true one


def noise(scale, seed=0, count=2000):
    return scale * np.random.default_rng(seed).standard_normal(count)


def estimate(times, values, names=None):
    """Return frequencies and damping ratios, their standard deviations, and the warnings."""
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("always")
        found = fm.Ringing.estimate(times, values, names)
    return found.measured, found.deviations, [str(each.message).removeprefix("ringing: ") for each in remarks]


def assert_covered(found, truth, width=3.0):
    """Assert that estimates are within some standard deviations of the truth."""
    measured, deviations, _ = found
    assert measured.shape == np.shape(truth)
    assert (np.abs(measured - truth) <= width * deviations).all()


@pytest.mark.parametrize("frequency", [0.7, 40.0, 130.0])
@pytest.mark.parametrize("harmonics", [1, 3])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_tone_of_a_motor_is_refused_as_no_decay(frequency, harmonics, seed):
    times = TIMES * 40.0 / frequency
    tone = sum(np.cos(2.0 * np.pi * k * frequency * times + k) / k**2 for k in range(1, harmonics + 1))
    assert re.match(r"ringing: '\S+ Hz with a damping ratio of \S+ \+- \S+' is not allowed; give a record that proves",
                    refusal(fm.Ringing.estimate, times, tone + noise(0.01, seed)))  # fmt: skip


@pytest.mark.parametrize("tone", [6.0, 14.0])
def test_tone_beside_a_decaying_vibration_is_left_out(tone):
    values = decay(TIMES, 9.0, 0.02) + 0.5 * np.cos(2.0 * np.pi * tone * TIMES) + noise(0.01)
    found = estimate(TIMES, values)
    assert_covered(found, [9.0, 0.02])
    (line,) = found[2]
    assert re.fullmatch(rf"{tone:.4g} Hz with a damping ratio of \S+ \+- \S+ does not decay and is left out", line)


@pytest.mark.parametrize("limits", [(-0.5, 0.5), (-2.0, 0.4), (-0.7, 0.3)])
@pytest.mark.parametrize("later", [0.0, 0.005])
@pytest.mark.parametrize("frequency", [2.0, 21.0])
def test_readings_at_the_limits_of_a_sensor_do_not_change_the_damping(limits, later, frequency):
    """Also with noise after the limits, whose readings are not equal."""
    times = TIMES * 21.0 / frequency
    clipped = np.clip(decay(times, frequency, 0.03) + noise(0.005, 1), *limits)
    found = estimate(times, clipped + noise(later, 2))
    assert_covered(found, [frequency, 0.03])
    assert found[1][1] < 0.02 * 0.03
    assert re.fullmatch(r"\d+ readings at a limit of the sensor are left out", found[2][0])


@pytest.mark.parametrize("ratio", [0.002, 0.05])
def test_vibration_within_the_limits_of_a_sensor_has_no_warning(ratio):
    assert estimate(TIMES, decay(TIMES, 5.0, ratio) + noise(0.01, 2))[2] == []


@pytest.mark.parametrize("level", [0.05, 0.2, 0.7])
def test_clipped_tone_is_refused(level):
    values = np.clip(decay(TIMES, 100.0 / 3.0, 0.0), -level, level)
    assert refusal(fm.Ringing.estimate, TIMES, values).startswith("ringing: ")


@pytest.mark.parametrize("steps", [4, 15])
def test_rounding_widens_the_interval_and_the_end_below_a_step_is_left_out(steps):
    exact = decay(TIMES, 5.0, 0.03)
    found = estimate(TIMES, np.round(steps * exact))
    assert_covered(found, [5.0, 0.03])
    assert re.fullmatch(r"\d+ readings of a vibration smaller than a step of rounding are left out", found[2][0])
    assert (found[1] > 10.0 * estimate(TIMES, exact)[1]).all()


@pytest.mark.parametrize("step", [1e-9, 0.02])
def test_repeated_readings_are_left_out(step):
    """Of a sensor at half the rate of the log, and of one packet in ten."""
    exact = step * np.round((decay(TIMES, 12.0, 0.01) + noise(0.005, 3)) / step)
    found = estimate(TIMES, exact[np.arange(2000) // 2 * 2])
    assert_covered(found, [12.0, 0.01])
    assert any(re.fullmatch(r"\d+ readings that repeat the one before are left out", line) for line in found[2])
    if step < 0.01:  # one in ten is no surplus over those that rounding makes
        lost = np.random.default_rng(3).random(2000) < 0.1
        found = estimate(TIMES, np.where(lost, np.roll(exact, 1), exact))
        assert_covered(found, [12.0, 0.01])
        assert "readings that repeat the one before are left out" in found[2][0]


def test_times_with_jitter_and_gaps_are_those_of_the_fit():
    times = np.delete(TIMES + np.random.default_rng(5).uniform(-6e-4, 6e-4, 2000), slice(300, 420))
    values = decay(times, 20.0, 0.01) + noise(0.001, 5, len(times))
    found = estimate(times, values)
    assert_covered(found, [20.0, 0.01])
    assert found[2] == []


def test_time_stamps_that_vary_more_than_the_sampling_are_read_as_equal_steps():
    values = decay(TIMES, 20.0, 0.01) + noise(0.001, 6)
    stamps = TIMES + np.random.default_rng(6).uniform(-6e-4, 6e-4, 2000)
    found = estimate(stamps, values)
    assert_covered(found, [20.0, 0.01], width=4.0)
    assert found[2] == [f"steps up to {found[2][0].split()[3]} % from the median are read as equal ones"]


@pytest.mark.parametrize("orders", [1, 2])
@pytest.mark.parametrize("shown", [["q"], ["dq"], ["q", "dq"]])
def test_step_response_with_slow_real_poles_has_the_poles_of_its_transfer_function(orders, shown):
    """2.638 Hz with 0.326, beside a real pole of 0.9 Hz, or two that are nearly equal."""
    ratio, damped, slow = 0.326, 2.0 * np.pi * 2.638, 2.0 * np.pi * 0.9
    natural = damped / np.sqrt(1.0 - ratio**2)
    real = [1.0, slow] if orders == 1 else [1.0, 2.0 * 0.97 * slow, slow**2]
    rest = natural**2 * real[-1]
    denominator = np.polymul([1.0, 2.0 * ratio * natural, natural**2], real)
    numerators = {"q": [rest], "dq": [rest, 0.0]}
    response = [lsim(lti(numerators[name], denominator), np.ones(1500), TIMES[:1500])[1] for name in shown]
    found = estimate(TIMES[:1500], np.column_stack(response))
    assert found[0] == pytest.approx([2.638, 0.326], rel=1e-3)


def test_column_with_another_frequency_is_named_and_widens_the_interval():
    columns = np.column_stack([decay(TIMES, each, 0.02) for each in (5.0, 5.0, 5.03)])
    columns += noise(0.01, 6, (2000, 3))
    measured, deviations, remarks = estimate(TIMES, columns, ["x", "y", "z"])
    assert any(each.startswith("z has 5.0297 Hz, and all columns together 5.0098 Hz") for each in remarks)
    assert deviations[0] >= 0.5 * (5.03 - measured[0]) * 0.9
    assert estimate(TIMES, columns[:, :2])[2] == []


def test_columns_with_one_mode_each_are_named():
    columns = np.column_stack([decay(TIMES, 5.0, 0.02), decay(TIMES, 8.0, 0.02)]) + noise(0.01, 7, (2000, 2))
    measured, _, remarks = estimate(TIMES, columns, ["x", "y"])
    assert measured == pytest.approx([5.0, 0.02], rel=0.01)
    assert remarks == ["y: 8 Hz, and 5 Hz in the other columns; it is left out"]


def test_columns_without_a_vibration_are_left_out_by_name():
    columns = np.column_stack([decay(TIMES, 5.0, 0.02) + noise(0.01, 8), noise(1.0, 9), np.ones(2000)])
    found = estimate(TIMES, columns, ["x", "noise", "command"])
    assert_covered(found, [5.0, 0.02])
    lines = ["command: constant readings are left out", "noise: no vibration is found; it is left out"]
    assert found[2] == lines


def test_frequencies_within_half_a_cycle_over_the_record_are_not_two_modes():
    times = TIMES[:500]
    values = decay(times, 10.0, 0.02) + 0.5 * decay(times, 10.5, 0.02, 2.0) + noise(0.01, 9, 500)
    assert len(estimate(times, values)[0]) == 2  # one frequency and one damping ratio


@pytest.mark.parametrize(
    ("times", "values", "names", "line"),
    [
        (TIMES[::-1], TIMES, None, "ringing: time: '3.996 after 3.998 s' is not allowed"),
        (TIMES[:10], TIMES[:10], None, "ringing: time: 'shape (10,)' is not allowed; give at least 16"),
        (TIMES[:20], TIMES, None, "ringing: values: 'shape (2000, 1)' is not allowed; give (20,) or (20, c)"),
        (TIMES, np.where(TIMES > 3.997, np.inf, TIMES), None, "ringing: values: '1 readings' is not allowed"),
        (TIMES, TIMES, ["a", "b"], "ringing: names: ['a', 'b'] is not allowed; give 1 names, one for each column"),
        (TIMES[:150], decay(TIMES[:150], 5.0, 0.02), None, "ringing: 'a record of "),
    ],
)
def test_wrong_records_are_refused_in_one_line(times, values, names, line):
    assert refusal(fm.Ringing.estimate, times, values, names).startswith(line)


def covered_and_false(kind, seed):
    """Return whether the intervals (k, 2) of found modes cover the truth, and the numbers of false and missed modes."""
    record, covered = made_record(kind, seed), []
    try:
        measured, deviations, _ = estimate(record.times, record.values)
    except ValueError:
        return covered, 0, len(record.modes)
    found = np.stack([measured, deviations], axis=1).reshape(2, -1, 2).swapaxes(0, 1)  # mode; frequency, ratio; value
    free = list(range(len(found)))
    for mode in record.modes:
        near = [i for i in free if abs(found[i, 0, 0] - mode[0]) < SAME * mode[0]]
        if near:
            free.remove(near[0])
            covered.append(np.abs(found[near[0], :, 0] - mode) <= COVERED * found[near[0], :, 1])
    return covered, len(free), len(record.modes) - len(covered)


def test_intervals_of_95_percent_hold_and_false_modes_are_rare():
    """Six records of each kind: one and two modes, noise, clipping, rounding, drift, jitter, tones."""
    results = [covered_and_false(kind, seed) for kind in KINDS for seed in range(6)]
    covered = np.array([each for modes, _, _ in results for each in modes])
    assert (covered.mean(axis=0) >= 0.9).all()
    assert sum(false for _, false, _ in results) <= 0.02 * len(results)
    assert sum(missed for _, _, missed in results) <= 0.05 * len(covered)
