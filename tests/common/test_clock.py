"""Tests of times: their column, their unit, and steps that are equal, rounded, jittered or have gaps."""

import numpy as np
import pytest

from flexman_gym.common.clock import MAX_JITTER, EqualTimes, Sampling, find_clock, is_time

from oracles.assertions import refusal

COUNT = 400


def clock(names, columns, texts=None, has_headers=True):
    """The clock of columns with names and units."""
    pairs = [each if isinstance(each, tuple) else (each, "") for each in names]
    return find_clock("a.csv", pairs, np.column_stack(columns), texts or {}, has_headers)


@pytest.mark.parametrize(
    "name",
    ["time", "Time", "T", "t", "Time Stamp", "timestamp", "__time", "Zeit", "micros", "t_ms", "Time_s_", "millis",
     "Latest: Time", "field.header.stamp", "seconds_elapsed", "X_Value", "sec", "ros time", "time 2"],
)  # fmt: skip
def test_names_of_times_are_known(name):
    assert is_time(name)


@pytest.mark.parametrize("name", ["temperature", "acc", "timeout", "t_1", "runtime_error", "position", "torque", "tip"])
def test_other_names_are_no_times(name):
    assert not is_time(name)


@pytest.mark.parametrize(("name", "unit"), [("micros", "us"), ("t_ms", "ms"), ("Time_s_", "s"), ("timestamp_ns", "ns")])
def test_a_unit_in_the_name_is_that_of_the_time_without_a_remark(name, unit):
    factor = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    found = clock([name, "a"], [0.001 * np.arange(COUNT) / factor, np.zeros(COUNT)])
    assert (found.unit, found.notes) == (unit, ()) and np.diff(found.times) == pytest.approx(0.001)


@pytest.mark.parametrize(
    ("unit", "start", "step"),
    [("s", 0.0, 0.004), ("ms", 512.0, 4.0), ("us", 21349977.0, 1890.0), ("us", 0.0, 312.0), ("s", 1.7e9, 0.008),
     ("ms", 1.7e12, 8.0), ("us", 1.7e15, 100.0), ("ns", 1.7e18, 1e6), ("s", 1.7e9, 1.0)],
)  # fmt: skip
def test_a_time_without_a_unit_is_recognised_by_its_size_or_steps_and_told(unit, start, step):
    found = clock(["time", "a"], [start + step * np.arange(COUNT), np.zeros(COUNT)])
    assert found.unit == unit
    assert bool(found.notes) == (unit != "s" or start > 1e9) and all(
        f"taken as {unit} " in note for note in found.notes
    )


@pytest.mark.parametrize("step", [1.0, 100.0, 150.0])
def test_steps_that_fit_two_units_are_refused_with_the_remedy(step):
    line = refusal(clock, ["time", "a"], [step * np.arange(COUNT), np.zeros(COUNT)])
    assert line == (
        f"a.csv: time: 'steps of {step:g} without a unit' is not allowed; give its unit in the headers, such as time "
        f"(ms), one of s, ms, us, ns, min"
    )


def test_the_first_column_is_the_time_only_where_it_increases_steadily():
    steady, values = 0.01 * np.arange(COUNT), np.sin(np.arange(COUNT))
    found = clock(["Var1", "Var2"], [steady, values])
    assert found.column == 0 and found.notes == ("Var1 is taken as the time, as it increases steadily",)
    assert clock(["column 1", "column 2"], [steady, values], has_headers=False).notes == (
        "no headers: the first column is the time, as it increases steadily",
    )
    assert "none of a, b is the time" in refusal(clock, ["a", "b"], [values, steady])
    assert "none of a, b is the time" in refusal(clock, ["a", "b"], [steady**8, values])
    assert "none of sample, b is the time" in refusal(clock, ["sample", "b"], [np.arange(COUNT), values])


def test_a_second_time_is_used_if_the_first_one_does_not_increase():
    found = clock(
        ["Date", "Time"],
        [np.full(3, np.nan)] * 2,
        {0: ["2026-03-01"] * 3, 1: ["09:00:00,5", "09:00:01", "09:00:02.25"]},
    )
    assert found.column == 1 and found.times == pytest.approx([0.0, 0.5, 1.75])


def test_dates_are_read_from_the_first():
    found = clock(["t"], [np.full(2, np.nan)], {0: ["2026-03-01 23:59:59.5", "2026-03-02T00:00:00.75"]})
    assert found.times == pytest.approx([0.0, 1.25]) and found.notes == ("t is read in s from its first date",)
    line = refusal(clock, ["t"], [np.full(2, np.nan)], {0: ["01.03.2026 12:00:00"] * 2})
    assert line.startswith("a.csv: t: '01.03.2026 12:00:00' is not allowed; give seconds, or dates such as 2026-")


def test_times_that_decrease_and_other_units_are_refused():
    times = np.append(0.1 * np.arange(9), 0.0)
    assert "a.csv: time: '0 after 0.8' is not allowed; give one record" in refusal(clock, ["time", "a"], [times] * 2)
    assert refusal(clock, [("time", "N"), "a"], [times] * 2).startswith("a.csv: the unit of time: 'N' is not allowed")


def test_equal_steps_keep_their_times_to_the_bit():
    times = 0.1 * np.arange(COUNT) + 7.0
    found = EqualTimes.of("a", times)
    assert np.array_equal(found.times, times) and not found.note and not found.is_interpolated


@pytest.mark.parametrize("drift", [0.0, 0.04])
def test_rounded_times_are_equal_steps_of_the_mean_rate(drift):
    """Steps of 2, 3, 2, 3 ms are those of 2.5 ms; a clock that is too fast has another mean, and no gap."""
    period = 0.0025 * (1.0 + drift)
    found = EqualTimes.of("a", np.round(period * np.arange(4 * COUNT), 3))
    assert not found.is_interpolated and np.diff(found.times) == pytest.approx(period, rel=1e-4)
    assert found.note.startswith("times rounded to 1 ms are read as equal steps of 2.")


def test_a_clock_slower_than_the_samples_is_that_of_the_mean_rate():
    found = EqualTimes.of("a", np.floor(3.2 * np.arange(4 * COUNT)) / 3.2 // 1e-3 * 1e-3)
    assert np.diff(found.times) == pytest.approx(np.mean(np.diff(found.times)))
    found = EqualTimes.of("a", np.floor(1e3 * np.arange(4 * COUNT) / 3200.0) / 1e3)
    assert np.diff(found.times) == pytest.approx(1.0 / 3200.0, rel=1e-3) and not found.is_interpolated


def test_a_lost_sample_among_rounded_times_is_a_gap():
    kept = np.delete(np.arange(COUNT), COUNT // 2)
    assert Sampling.of(np.round(0.0025 * kept, 3)).rounding == 0.0
    assert "a: time: 'a step of 5 ms after" in refusal(EqualTimes.of, "a", np.round(0.0025 * kept, 3))


@pytest.mark.parametrize("share", [0.02, 0.2, 0.95 * MAX_JITTER])
def test_steps_that_vary_are_interpolated_at_the_mean_rate(share):
    """The deviations of the steps add up: after a while the times are more than a step away from equal ones."""
    steps = 0.002 * (1.0 + share * np.random.default_rng(3).uniform(-1.0, 1.0, COUNT))
    times = np.append(0.0, np.cumsum(steps))
    found = EqualTimes.of("a", times)
    assert found.is_interpolated and np.diff(found.times) == pytest.approx(times[-1] / COUNT)
    assert found.times[[0, -1]] == pytest.approx(times[[0, -1]]) and "are interpolated to equal ones of 2" in found.note


def test_larger_gaps_are_refused_with_the_longest_part_without_any():
    times = np.delete(0.01 * np.arange(100), range(20, 30))
    line = refusal(EqualTimes.of, "a", times)
    assert line == (
        "a: time: 'a step of 110 ms after 0.19 s' is not allowed; give steps of 10 ms +- 50 %, such as the part from "
        "0.3 to 0.99 s"
    )


@pytest.mark.parametrize("times", [[0.0, 0.1, 0.2], [0.0, 0.1, 0.05, 0.2]])
def test_few_or_decreasing_times_are_refused(times):
    assert refusal(EqualTimes.of, "a", times).endswith("give at least 4 increasing times")
