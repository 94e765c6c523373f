"""Verification: its quick half passes, a wrong number fails, and its files hold every row."""

import json
from dataclasses import replace

import numpy as np
import pytest

from flexman_gym.__main__ import main as flexman
from flexman_gym.verification import cases
from flexman_gym.verification.closed_forms import (
    bar_eigenvalues,
    beam_eigenvalues,
    joint_eigenvalues,
    rayleigh_eigenvalues,
)
from flexman_gym.verification.table import (
    COLUMNS,
    VerificationRow,
    as_json,
    exit_code,
    markdown_page,
    printed_row,
    text_table,
)

from oracles.files import REFERENCE, ROOT

ROW = VerificationRow("a number, m", "a book", 2.0, 2.001, 1e-3)
# The reference scenes hold the printed area of link 1 and that of `one_link`, which no section can have.
pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")


@pytest.fixture(scope="module")
def rows():
    """The quick half."""
    return cases.rows(REFERENCE, quick=True)


def test_the_quick_half_passes(rows):
    assert [row for row in rows if row.verdict != "pass"] == [row for row in rows if row.tolerance is None]
    assert sum(row.tolerance is None for row in rows) <= 1
    assert len(rows) > 90 and exit_code(rows) == 0
    assert len({row.case for row in rows}) == len(rows)
    assert all(row.source for row in rows)


def test_a_wrong_expected_value_fails(rows):
    judged = [row for row in rows if row.tolerance is not None]
    wrong = [replace(row, expected=(row.expected + 1.0) * (1.0 + 2.0 * row.tolerance)) for row in judged]
    assert {row.verdict for row in wrong} == {"fail"}
    assert exit_code([*rows[1:], wrong[0]]) == 1


def test_a_wrong_expected_value_ends_the_command_with_1(monkeypatch, capsys):
    for row, code in ((ROW, 0), (replace(ROW, expected=3.0), 1)):
        monkeypatch.setattr(cases, "rows", lambda reference, quick, row=row: [row])
        assert flexman(["verify", "--quick"]) == code
        assert row.verdict in capsys.readouterr().out


def test_a_missing_folder_of_references_is_said_at_once(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        flexman(["verify", "--reference", str(tmp_path / "nowhere")])
    said = capsys.readouterr().err
    assert stop.value.code == 2 and "nowhere" in said


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


def test_a_printed_value_is_met_to_half_its_last_digit():
    for value, verdict in ((4.549, "pass"), (4.451, "pass"), (4.56, "fail"), (4.44, "fail")):
        assert printed_row("a frequency, Hz", "a book", "4.5", value).verdict == verdict


def test_nothing_computed_is_no_success():
    assert exit_code([]) == 1


def test_page_and_file_hold_all_rows(rows):
    shown = [*rows, replace(ROW, tolerance=None), replace(ROW, computed=np.inf)]
    lines = [line for line in markdown_page(shown).splitlines() if line.startswith("| ")]
    assert lines[0] == "| " + " | ".join(COLUMNS) + " |"
    assert len(lines) == 2 + len(shown)
    text = text_table(shown)
    for row, line in zip(shown, lines[2:], strict=True):
        assert line.startswith(f"| {row.case} | {row.source} |") and line.endswith(f"| {row.verdict} |")
        assert row.case in text
    loaded = json.loads(as_json(shown))
    assert [row["case"] for row in loaded["rows"]] == [row.case for row in shown]
    assert all(tuple(row) == COLUMNS for row in loaded["rows"])
    assert loaded["rows"][-1]["computed"] is None and loaded["machine"]["numpy"] == np.__version__


def test_the_page_in_docs_is_whole_and_has_no_failure(rows):
    lines = [line for line in (ROOT / "docs" / "verification.md").read_text(encoding="utf-8").splitlines()]
    table = [line for line in lines if line.startswith("| ")][2:]
    assert all(not line.endswith("| fail |") for line in table)
    assert {row.case for row in rows} <= {line.split(" | ")[0].removeprefix("| ") for line in table}


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
    result = joint_eigenvalues(len(expected), 100.0 * 0.7 / 0.6, rotor, tip / (4.0 * 0.7))
    assert result * np.sqrt(0.6 / (4.0 * 0.7**4)) / (2.0 * np.pi) == pytest.approx(expected, rel=2e-6)


def test_limits_of_the_closed_forms():
    slender, bar = (3.51601527, 22.03449156, 61.69721441), (0.5 * np.pi, 1.5 * np.pi)  # Blevins, 1979
    assert beam_eigenvalues(3) == pytest.approx(slender, rel=1e-8)
    assert joint_eigenvalues(3, 1e9, None, 0.0) == pytest.approx(slender, rel=1e-7)
    assert rayleigh_eigenvalues(3, 1e-12) == pytest.approx(slender, rel=1e-7)
    assert (rayleigh_eigenvalues(3, 1e-4) < slender).all()
    assert bar_eigenvalues(2) == pytest.approx(bar, rel=1e-15)
    assert bar_eigenvalues(2, 1000) == pytest.approx(bar, rel=1e-5)
