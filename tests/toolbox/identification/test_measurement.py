"""Measurements from files: columns with known names are read without mappings."""

import warnings

import numpy as np
import pytest

import flexman_gym as fm

from oracles.assertions import refusal

TIMES = 0.01 * np.arange(40)
HEADS = ("time (s)", "torque_1 (mN m)", "motor_angle_1 (deg)", "root_strain_1_y (um/m)", "tip_acceleration_x (g)")


def written(path, heads, columns):
    """A CSV file."""
    rows = np.column_stack(columns)
    path.write_text("\n".join([",".join(heads), *(",".join(map(str, row)) for row in rows.tolist())]), encoding="utf-8")
    return path


@pytest.fixture
def file(tmp_path):
    """A record with a torque and three outputs, in other units than those of SI."""
    return written(tmp_path / "run.csv", HEADS, (TIMES, 5.0 + 0.0 * TIMES, 90.0 * TIMES, 3.0 * TIMES, TIMES))


def test_known_columns_are_read_in_si_units_without_mappings(file):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = fm.Measurement.from_csv(file, gains=("root_strain_1_y",))
    assert list(read.inputs) == ["torque_1"] and read.inputs["torque_1"] == pytest.approx(5e-3 + 0.0 * TIMES)
    assert list(read.outputs) == ["motor_angle_1", "root_strain_1_y", "tip_acceleration_x"]
    assert read.outputs["motor_angle_1"] == pytest.approx(np.pi / 2.0 * TIMES)
    assert read.outputs["root_strain_1_y"] == pytest.approx(3e-6 * TIMES)
    assert read.outputs["tip_acceleration_x"] == pytest.approx(9.80665 * TIMES) and read.gains == ("root_strain_1_y",)


def test_a_mapping_goes_before_known_names(file):
    """A hub whose motion is given is an input, and then no output; what is left out on purpose is no slip."""
    warnings.simplefilter("error")
    read = fm.Measurement.from_csv(file, inputs={"motor_angle_1": "motor_angle_1"})
    assert list(read.inputs) == ["motor_angle_1"] and list(read.outputs) == ["root_strain_1_y", "tip_acceleration_x"]
    read = fm.Measurement.from_csv(file, outputs={"motor_angle_1": "motor_angle_1"})
    assert list(read.inputs) == ["torque_1"] and list(read.outputs) == ["motor_angle_1"]
    assert fm.Measurement.from_csv(file, inputs={}).inputs == {}


def test_columns_with_other_names_are_warned_of_and_a_file_without_known_ones_is_refused(tmp_path):
    some = written(tmp_path / "some.csv", ("time (s)", "motor_angle_1 (rad)", "motor_angel_2 (rad)"), [TIMES] * 3)
    with pytest.warns(UserWarning, match="some.csv: motor_angel_2 "):
        assert list(fm.Measurement.from_csv(some).outputs) == ["motor_angle_1"]
    none = written(tmp_path / "none.csv", ("time (s)", "hub (rad)"), [TIMES] * 2)
    line = refusal(fm.Measurement.from_csv, none)
    assert line.startswith("none.csv: the header: ['hub']") and "motor_angle_1" in line and "outputs=" in line


def test_a_known_name_in_a_wrong_unit_is_refused(tmp_path):
    wrong = written(tmp_path / "wrong.csv", ("time (s)", "torque_1 (A)", "motor_angle_1 (rad)"), [TIMES] * 3)
    assert "torque_1" in refusal(fm.Measurement.from_csv, wrong)


def test_every_column_of_a_trajectory_is_known_but_energies(tmp_path):
    """What a simulation wrote is read as what a machine did."""
    run = fm.simulate(fm.catalog.paper_scene("ff"), step=0.01)
    run.to_csv(tmp_path / "run.csv")
    with pytest.warns(UserWarning, match="energy, moving_energy, work, dissipation, energy_residual"):
        read = fm.Measurement.from_csv(tmp_path / "run.csv")
    heads = [head for head in run.columns() if not head.endswith(("(J)", "(s)"))]
    expected = {head.partition(" (")[0]: run.columns()[head] for head in heads}
    assert list(read.outputs) == list(expected)
    assert all(np.array_equal(read.outputs[name], each) for name, each in expected.items())
