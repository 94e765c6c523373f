"""Verification table: verdicts of correct and wrong values, and the output as text and JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest

from flexman_gym.__main__ import main as flexman
from flexman_gym.toolbox.verification import cases
from flexman_gym.toolbox.verification.closed_forms import (
    bar_frequencies,
    cantilever_frequencies,
    flexible_joint_frequencies,
)
from flexman_gym.toolbox.verification.table import COLUMNS, VerificationRow, VerificationTable

pytestmark = pytest.mark.slow

ROW = VerificationRow("a number, m", "a book", 2.0, 2.001, 1e-3)


@pytest.fixture(scope="module")
def rows():
    """Rows of the verify command."""
    return [row for case in cases.CLOSED_FORMS for row in case()]


def test_the_closed_forms_pass(rows):
    assert [row.case for row in rows if row.verdict != "pass"] == []
    assert len(rows) > 50 and VerificationTable(rows).exit_code == 0
    assert len({row.case for row in rows}) == len(rows)
    assert all(row.source for row in rows)


def test_a_wrong_expected_value_fails(rows):
    judged = [row for row in rows if row.tolerance is not None]
    wrong = [replace(row, expected=(row.expected + 1.0) * (1.0 + 2.0 * row.tolerance)) for row in judged]
    assert {row.verdict for row in wrong} == {"fail"}
    assert VerificationTable([*rows[1:], wrong[0]]).exit_code == 1


def test_a_wrong_expected_value_ends_the_command_with_1(monkeypatch, capsys):
    for row, code in ((ROW, 0), (replace(ROW, expected=3.0), 1)):
        monkeypatch.setattr(cases, "CLOSED_FORMS", [lambda row=row: [row]])
        assert flexman(["verify", "--quick"]) == code
        assert row.verdict in capsys.readouterr().out


def test_the_command_names_the_full_table_and_writes_the_rows(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(cases, "CLOSED_FORMS", [lambda: [ROW]])
    assert flexman(["verify", "--quick"]) == 0 and "make verify" not in capsys.readouterr().out
    assert flexman(["verify", "--json", str(tmp_path / "rows.json")]) == 0
    assert "is in docs/evidence/verification.md" in capsys.readouterr().out
    assert (tmp_path / "rows.json").read_text() == VerificationTable([ROW]).to_json()


@pytest.mark.parametrize(
    ("changes", "error", "verdict"),
    [
        ({}, 5e-4, "pass"),
        ({"expected": -2.001, "computed": -2.0}, 1e-3 / 2.001, "pass"),
        ({"tolerance": 1e-4}, 5e-4, "fail"),
        ({"tolerance": None}, 5e-4, "shown"),
        ({"expected": 0.0}, 2.001, "fail"),
        ({"computed": np.inf}, np.inf, "fail"),
        ({"computed": np.nan}, np.nan, "fail"),
    ],
)
def test_a_verdict_follows_from_error_and_tolerance(changes, error, verdict):
    row = replace(ROW, **changes)
    assert row.error == pytest.approx(error, nan_ok=True)
    assert row.verdict == verdict


def test_nothing_computed_is_no_success():
    assert VerificationTable().exit_code == 1


def test_table_and_file_hold_all_rows(rows):
    shown = VerificationTable([*rows, replace(ROW, tolerance=None), replace(ROW, computed=np.inf)])
    head, *lines, last = str(shown).splitlines()
    assert head.split() == [name for name in COLUMNS if name != "source"] and max(map(len, lines)) <= 100
    text = " ".join(" ".join(lines).split())
    for row in shown:  # each after the one before, below its source
        numbers = " ".join(row.cells()[2:]).split()
        _, found, text = text.partition(f"{row.case} {' '.join(numbers)}")
        assert found, row
    assert {f"{row.source}:" for row in shown} <= {*lines}
    assert last.startswith(f"{len(rows)} of {len(rows) + 1} rows pass, 1 fail;")
    loaded = json.loads(shown.to_json())
    assert [row["case"] for row in loaded["rows"]] == [row.case for row in shown]
    assert all(tuple(row) == COLUMNS for row in loaded["rows"])
    assert loaded["rows"][-1]["computed"] is None and loaded["machine"]["numpy"] == np.__version__


# The closed forms themselves


@pytest.mark.parametrize(
    ("tip", "clamped", "expected"),
    [  # Hz, of a closed form in another code: L 0.7 m, 4 kg/m, EI 0.6 N m^2, K 100 N m/rad, rotor 1 kg m^2
        (0.0, False, (0.521729, 2.741455, 7.643182, 14.97638)),
        (0.0, True, (0.434903, 2.726788, 7.638233)),
        (2.0, False, (0.340285, 2.065477, 6.349101)),
        (2.0, True, (0.220297, 2.046225, 6.343135)),
    ],
)
def test_a_beam_on_a_spring_and_a_rotor(tip, clamped, expected):
    rotor = None if clamped else 1.0 / (4.0 * 0.7**3)
    result = flexible_joint_frequencies(len(expected), 100.0 * 0.7 / 0.6, rotor, tip / (4.0 * 0.7))
    assert result * np.sqrt(0.6 / (4.0 * 0.7**4)) / (2.0 * np.pi) == pytest.approx(expected, rel=2e-6)


def test_limits_of_the_closed_forms():
    slender, bar = (3.51601527, 22.03449156, 61.69721441), (0.5 * np.pi, 1.5 * np.pi)  # Blevins, 1979
    assert cantilever_frequencies(3) == pytest.approx(slender, rel=1e-8)
    assert flexible_joint_frequencies(3, 1e9, None, 0.0) == pytest.approx(slender, rel=1e-7)
    assert bar_frequencies(2) == pytest.approx(bar, rel=1e-15)
    assert bar_frequencies(2, 1000) == pytest.approx(bar, rel=1e-5)
