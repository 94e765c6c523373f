"""Tests of motions in CSV files: unequal steps are resampled, columns chosen, and what is left out is told."""

import numpy as np
import pytest

from flexman_gym.common.files import write_csv
from flexman_gym.common.time_series import read_time_series
from flexman_gym.toolbox.controllers.input_shaping.motion import Motion

from oracles.assertions import refusal

CUBIC = np.polynomial.Polynomial([0.0, 0.0, 3.0, -2.0])
UNEVEN = np.append(np.cumsum([0.0, *(0.012, 0.01, 0.009, 0.01) * 24]), 1.0)


def file(path, times=UNEVEN, **more):
    """A file with angles and rates of the cubic, and other columns."""
    angles, rates = np.degrees(CUBIC(times)), np.degrees(CUBIC.deriv()(times))
    write_csv(path, {"time (ms)": 1e3 * times, "q (deg)": angles, "rate (deg/s)": rates} | more)
    return path


@pytest.mark.parametrize("rate", [None, 250.0])
def test_unequal_steps_are_resampled_by_the_rates(rate, tmp_path):
    motion = Motion.read(file(tmp_path / "in.csv"), rate)
    times = motion.period * np.arange(len(motion.values))
    assert motion.period == pytest.approx(1.0 / rate if rate else 0.01)
    assert motion.values == pytest.approx(np.column_stack([CUBIC(times), CUBIC.deriv()(times)]), abs=1e-9)
    motion.write(tmp_path / "out.csv")
    again = read_time_series(tmp_path / "out.csv")
    assert (tmp_path / "out.csv").read_text().startswith("time (ms),q (deg),rate (deg/s)\n")
    assert again.times == pytest.approx(times) and again.table == pytest.approx(motion.values)


def test_columns_that_are_no_motion_are_told(tmp_path):
    more = {"current (A)": UNEVEN, "target_q (deg)": UNEVEN, "gauge": UNEVEN}
    motion = Motion.read(file(tmp_path / "in.csv", **more))
    assert motion.values.shape[1] == 2 and motion.remarks[:4] == (
        "in.csv: read as time in ms, q in deg, rate in deg/s",
        "in.csv: gauge not read: no known unit",
        "in.csv: target_q not read: command, set point or temperature by name",
        "in.csv: current not read: neither position, velocity nor acceleration",
    )


def test_chosen_columns_may_be_given_with_their_unit(tmp_path):
    path = tmp_path / "in.csv"
    write_csv(path, {"timestamp": 4156.2 + UNEVEN, "actual_q_0": CUBIC(UNEVEN), "actual_current_0": UNEVEN})
    assert refusal(Motion.read, path).startswith(
        "in.csv: the units: 'actual_q_0 without a unit, actual_current_0 without"
    )
    motion = Motion.read(path, columns=["actual_q_0 (rad)"])
    assert motion.start == pytest.approx(4156.2) and motion.positions[-1] == pytest.approx([1.0])
    motion.write(tmp_path / "out.csv")
    assert (tmp_path / "out.csv").read_text().startswith("timestamp,actual_q_0 (rad)\n")


def test_a_rate_that_belongs_to_no_position_is_interpolated(tmp_path):
    motion = Motion.read(file(tmp_path / "in.csv", **{"p (rad)": CUBIC(UNEVEN)}))
    assert motion.remarks[-1] == "in.csv: rate taken as lines between samples: not one for each position"
    times = motion.period * np.arange(len(motion.values))
    assert motion.values[:, 1] == pytest.approx(CUBIC.deriv()(times), abs=1e-3)
    assert motion.values[:, [0, 2]] == pytest.approx(np.column_stack([CUBIC(times)] * 2), abs=1e-12), "its own spline"


def test_a_wrong_rate_is_refused(tmp_path):
    assert refusal(Motion.read, file(tmp_path / "in.csv"), -1.0).startswith("rate: -1.0 is not allowed")
