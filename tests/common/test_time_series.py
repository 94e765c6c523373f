"""Tests of time series: remarks about how records are read, chosen columns, and lines without numbers."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.common.time_series import TimeSeries, read_time_series

from oracles.assertions import refusal

TIMES = 0.01 * np.arange(60)


def written(path, heads, *columns, separator=","):
    """The path of a file with columns of numbers or cells."""
    cells = [[each if isinstance(each, str) else repr(float(each)) for each in column] for column in columns]
    rows = [separator.join(row) for row in zip(*cells, strict=True)]
    path.write_text("\n".join([separator.join(heads), *rows]) + "\n", encoding="utf-8")
    return path


def test_units_as_read_and_assumptions_are_remarks(tmp_path):
    plain = read_time_series(written(tmp_path / "a.csv", ["time (s)", "acceleration (g)"], TIMES, TIMES))
    assert plain.remarks == ["a.csv: read as time in s, acceleration in g"] and plain.notes == ()
    path = written(tmp_path / "b.csv", ["#time", "accel_x", "accel_y", "v (counts)"], 5.0 + TIMES, TIMES, TIMES, TIMES)
    assert read_time_series(path).remarks == ["b.csv: read as time in s, accel_x, accel_y without a unit, v in counts"]
    found = read_time_series(written(tmp_path / "c.csv", ["Time Stamp", "a"], 21349977.0 + 1e6 * TIMES, TIMES))
    assert found.remarks == [
        "c.csv: read as time in us, a without a unit",
        "c.csv: Time Stamp has no unit: taken as us by its steps of 1e+04",
    ]  # fmt: skip
    assert np.diff(found.times) == pytest.approx(0.01) and found.times[0] == pytest.approx(21.349977)


def test_columns_of_many_names_are_told_in_one_short_line(tmp_path):
    path = written(tmp_path / "a.csv", ["time (s)", *(f"x{i}" for i in range(40))], TIMES, *40 * [TIMES])
    [line] = read_time_series(path).remarks
    assert line.endswith("x10, x11 and 28 more without a unit")


def test_commands_and_set_points_are_left_out_and_told_unless_chosen(tmp_path):
    heads = ["time (s)", "q", "target_q", "q_cmd", "motor_temp", "index"]
    path = written(tmp_path / "a.csv", heads, TIMES, *(k + TIMES for k in range(4)), np.arange(60.0))
    found = read_time_series(path)
    assert [*found.columns] == ["q"] and found.notes == (
        "index not read: count of lines",
        "target_q, q_cmd, motor_temp not read: command, set point or temperature by name",
    )
    chosen = read_time_series(path, ["motor_temp", "q"])
    assert chosen.table == pytest.approx(np.column_stack([3.0 + TIMES, TIMES])) and chosen.notes == ()
    only = read_time_series(written(tmp_path / "b.csv", ["t (s)", "target_q"], TIMES, TIMES))
    assert [*only.columns] == ["target_q"], "the only readings of a file are not left out"


def test_a_name_in_a_file_twice_keeps_both_columns(tmp_path):
    path = written(tmp_path / "a.csv", ["time (s)", "a", "a", "a_2", "a"], TIMES, *(k + TIMES for k in range(4)))
    found = read_time_series(path)
    assert {name: values[0] for name, (_, values) in found.columns.items()} == {"a": 0, "a_2": 1, "a_2_2": 2, "a_3": 3}
    assert found.notes == ("a_2, a_2_2, a_3 read: names that occur again",)


@pytest.mark.parametrize("given", ["q_1", "Q_1", "q_1 (deg)", "q_1 (degrees)"])
def test_chosen_columns_are_found_by_name_or_header(given, tmp_path):
    path = written(tmp_path / "a.csv", ["time (s)", "q_1 (deg)", "q_2 (deg)"], TIMES, 180.0 * TIMES, TIMES)
    assert read_time_series(path, [given], ["rad"]).table[:, 0] == pytest.approx(np.pi * TIMES)


def test_a_unit_may_be_given_with_the_name_where_the_file_has_none(tmp_path):
    path = written(tmp_path / "a.csv", ["time (s)", "q", "v (V)"], TIMES, 180.0 * TIMES, TIMES)
    assert read_time_series(path, ["q (deg)"], ["rad"]).table[:, 0] == pytest.approx(np.pi * TIMES)
    assert refusal(read_time_series, path, ["v (rad)"]) == (
        "a.csv: columns[0]: 'v (rad)' is not allowed; give v in V, as in the file"
    )
    assert refusal(read_time_series, path, ["w"]) == "a.csv: columns[0]: 'w' is not allowed; give one of q, v"
    assert refusal(read_time_series, path, ["q"], ["rad"]) == (
        "a.csv: the units: 'q without a unit' is not allowed; give columns in one of rad, mrad, deg, in the header or "
        "as a chosen column 'NAME (UNIT)'"
    )
    assert refusal(read_time_series, path, []).startswith("a.csv: columns: [] is not allowed")


def test_a_column_without_a_unit_beside_those_with_one_is_told_where_units_are_needed(tmp_path):
    path = written(tmp_path / "a.csv", ["time (s)", "torque_1 (N m)", "torque_2"], TIMES, TIMES, TIMES)
    with pytest.warns(UserWarning, match="a.csv: torque_2 not read: no known unit"):
        assert np.shape(fm.SampledTorque.from_csv(path).values) == (60, 1)


def test_lines_without_numbers_in_the_chosen_columns_are_left_out_and_told(tmp_path):
    cells = [repr(float(each)) for each in TIMES]
    some = [*cells[:7], "", "NaN", *cells[9:]]
    turns = ["" if i % 2 else each for i, each in enumerate(cells)]
    path = written(tmp_path / "a.csv", ["time (s)", "a", "b", "c"], TIMES, cells, some, turns)
    found = read_time_series(path)
    assert [*found.columns] == ["a", "b"] and len(found.times) == 58 and np.isfinite(found.table).all()
    assert found.notes == (
        "c not read: numbers in 50 % of the lines", "2 of 60 lines lack a number, the first at 0.07 s: not read",
    )  # fmt: skip
    assert read_time_series(path, ["c"]).times == pytest.approx(TIMES[::2])
    line = refusal(read_time_series, path, ["a", "c"])
    assert line.startswith("a.csv: columns: 'numbers missing in 50 % of the lines' is not allowed; give at most 10 %")


def test_seconds_and_nanoseconds_of_a_stamp_are_one_time(tmp_path):
    stamps = [divmod(round(1e9 * (1.7e9 + each)), 10**9) for each in TIMES]
    heads = ["header.stamp.sec", "header.stamp.nanosec", "frame_id", "x"]
    columns = [[str(sec) for sec, _ in stamps], [str(rest) for _, rest in stamps], 60 * ["base"], TIMES]
    found = read_time_series(written(tmp_path / "a.csv", heads, *columns))
    assert found.times - 1.7e9 == pytest.approx(TIMES, abs=1e-6) and [*found.columns] == ["x"]
    assert found.notes == ("frame_id not read: no numbers",)


def test_a_file_with_a_time_alone_is_refused(tmp_path):
    line = refusal(read_time_series, written(tmp_path / "a.csv", ["time (s)", "frame"], TIMES, 60 * ["base"]))
    assert line == "a.csv: the columns: ['time', 'frame'] is not allowed; give columns beside the time"


@pytest.mark.feature
def test_equal_steps_interpolate_smooth_columns_by_splines_and_others_linearly(tmp_path):
    """A cubic polynomial is its own spline; a line is its own interpolation; the mean rate has no drift."""
    times = np.append(0.0, np.cumsum(0.01 * (1.0 + 0.3 * np.random.default_rng(1).uniform(-1.0, 1.0, 400))))
    path = written(
        tmp_path / "a.csv", ["time (s)", "torque_1 (N m)", "motor_angle_1 (rad)"], times, 2.0 * times, times**3
    )
    even = TimeSeries.read(path).in_equal_steps(linear=["torque_1"])
    assert np.diff(even.times) == pytest.approx(times[-1] / 400)
    assert even.table == pytest.approx(np.column_stack([2.0 * even.times, even.times**3]), rel=1e-9)
    with pytest.warns(UserWarning, match="a.csv: steps of .* are interpolated to equal ones of"):
        read = fm.Measurement.from_csv(path)
    assert read.period == pytest.approx(times[-1] / 400)
    assert read.outputs["motor_angle_1"] == pytest.approx(np.asarray(read.times) ** 3, rel=1e-9)


@pytest.mark.feature
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_ringing_of_a_file_has_the_mode_of_the_record(share, tmp_path):
    """In any unit, beside set points, with a clock that jitters and drifts."""
    rate, ratio = 2.0 * np.pi * 7.0, 0.01
    times = np.append(0.0, np.cumsum(0.002 * (1.0 + share * np.random.default_rng(2).uniform(-1.0, 1.0, 1500))))
    values = np.exp(-ratio * rate * times) * np.cos(rate * times)
    path = written(
        tmp_path / "a.csv", ["micros", "gauge", "setpoint"], np.round(1e6 * times), values, np.sin(3.0 * times)
    )
    with pytest.warns(UserWarning, match="a.csv: setpoint not read"):
        found, chosen = fm.Ringing.from_csv(path), fm.Ringing.from_csv(path, ["gauge"])
    assert found.frequencies == pytest.approx([7.0], rel=1e-4) and chosen.frequencies == found.frequencies
    assert found.damping == pytest.approx([ratio / np.sqrt(1.0 + ratio**2)], rel=2e-2)
