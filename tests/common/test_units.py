"""Tests of headers: spellings of units, and names of columns that are no readings."""

import numpy as np
import pytest

from flexman_gym.common.units import UNITS, find_unit, is_command, is_counter, split_header


def test_every_unit_is_a_multiple_of_its_si_unit():
    """A thousandth is a milli, and so on; standard gravity, degrees and revolutions by their definitions."""
    ones = {
        "ms": 1e3, "us": 1e6, "ns": 1e9, "min": 1.0 / 60.0, "mN m": 1e3, "kN m": 1e-3, "mN": 1e3, "kN": 1e-3,
        "mrad": 1e3, "deg": 180.0 / np.pi, "deg/s": 180.0 / np.pi, "deg/s^2": 180.0 / np.pi, "rpm": 30.0 / np.pi,
        "cm": 1e2, "mm": 1e3, "um": 1e6, "cm/s": 1e2, "mm/s": 1e3, "mm/s^2": 1e3, "g": 1.0 / 9.80665,
        "mg": 1e3 / 9.80665, "mA": 1e3, "mV": 1e3, "uV": 1e6, "um/m": 1e6,
    }  # fmt: skip
    for unit, (basic, factor) in UNITS.items():
        assert factor * ones.get(unit, 1.0) == pytest.approx(1.0), unit
        assert UNITS[basic] == (basic, 1.0), unit


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("Time (s)", "Time", "s"), ("Time [s]", "Time", "s"), ("t (sec)", "t", "s"), ("t(seconds)", "t", "s"),
        ("Time, s", "Time", "s"), ("Zeit in ms", "Zeit", "ms"), ("Zeit / s", "Zeit", "s"), ("t/s", "t", "s"),
        ("#time", "time", ""), ("%time", "time", ""), ("x (µV)", "x", "uV"), ("x (uV)", "x", "uV"),  # noqa: RUF001
        ("Acceleration x (m/s²)", "Acceleration x", "m/s^2"), ("a (m/s2)", "a", "m/s^2"), ("a (G)", "a", "g"),
        ("a (mg)", "a", "mg"), ("drive (mN*m)", "drive", "mN m"), ("drive (N·m)", "drive", "N m"),
        ("rate (°/s)", "rate", "deg/s"), ("rate (dps)", "rate", "deg/s"), ("strain [1]", "strain", "1"),
        ("q_deg", "q_deg", "deg"), ("acc_m_s2", "acc_m_s2", "m/s^2"), ("acc (counts)", "acc", "counts"),
        ("/joint_states/position[0]", "/joint_states/position[0]", ""), ("position[1] (rad)", "position[1]", "rad"),
        ("/arm/elbow/s", "/arm/elbow/s", ""), ("motor_angle_1", "motor_angle_1", ""), ('"acc (g)"', "acc", "g"),
    ],
)  # fmt: skip
def test_headers_are_split_into_name_and_unit(header, name, unit):
    assert split_header(header) == (name, unit)


def test_capital_letters_that_change_a_unit_are_not_ignored():
    """A meganewton is no millinewton."""
    assert find_unit("MN") is None and find_unit("mN") == "mN" and find_unit("MS") == "ms"


@pytest.mark.parametrize(
    "name",
    ["target_q_0", "q_cmd", "setPoint", "set point", "Command", "pos_ref", "reference_2", "tau", "motor_temp_1",
     "Temperatur", "desired position", "targetCurrent"],
)  # fmt: skip
def test_commands_set_points_and_temperatures_are_known_by_name(name):
    assert is_command(name)


@pytest.mark.parametrize("name", ["actual_q_0", "temporal", "preference", "torque_1", "strain", "taut", "acc_x"])
def test_names_that_contain_a_command_within_a_word_are_readings(name):
    assert not is_command(name)


def test_counts_of_lines_are_known_by_name():
    assert is_counter("field.header.seq") and is_counter("Sample") and not is_counter("encoder_count")
