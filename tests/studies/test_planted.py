"""Tests of the planted errors: the error files match the sources, and outcomes are classified correctly."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from studies.files import write_rows
from studies.planted.measure import (
    CAUGHT,
    EQUIVALENT,
    PARTS,
    SURVIVED,
    Change,
    Copy,
    Planted,
    changes,
    code_of,
    is_current,
    kept,
    misplaced,
    outdated,
    planted,
    with_first_test,
)

from oracles.assertions import refusal
from oracles.files import command

ROOT = Path(__file__).parents[2]
DOUBLE = Change("part", "halves", "double.py", "2 * x", "x / 2", ("test_double.py",))


@pytest.fixture
def checkout(tmp_path):
    """Return a checkout with one function, its test and an empty folder of agents."""
    folder = tmp_path / "checkout"
    (folder / "agents").mkdir(parents=True)
    (folder / "double.py").write_text("def double(x):\n    return 2 * x + 0 * abs(x)\n")
    (folder / "test_double.py").write_text("import double\n\n\ndef test_one():\n    assert double.double(1) == 2\n")
    (folder / "pyproject.toml").write_text('[tool.pytest.ini_options]\npythonpath = ["."]\n')
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    return folder


def test_every_error_of_the_table_has_its_place_and_its_tests():
    every = [change for part in PARTS.values() for change in part]
    assert misplaced(ROOT, every) == []
    assert len(every) >= 120 and len({(change.part, change.error) for change in every}) == len(every)
    assert all(change.part == name for name, every in PARTS.items() for change in every)


@pytest.mark.slow
def test_an_error_is_caught_or_survives_or_is_equivalent(checkout, tmp_path):
    copy = Copy(checkout, tmp_path / "copy")
    assert copy.failing(["test_double.py"]) == ""
    result = copy.plant(DOUBLE)
    assert result.outcome == CAUGHT and result.by == "test_double.py::test_one"
    unseen = replace(DOUBLE, old="0 * abs(x)", new="0.5 * (abs(x) - 1)")
    assert copy.plant(unseen).outcome == SURVIVED
    same = copy.plant(replace(DOUBLE, old="0 * abs(x)", new="0", equivalent="zero times anything"))
    assert (same.outcome, same.by) == (EQUIVALENT, "zero times anything")
    assert copy.plant(replace(DOUBLE, equivalent="is not so")).outcome == CAUGHT
    assert copy.plant(replace(DOUBLE, new="syntax error")).outcome == CAUGHT
    assert (copy.root / "double.py").read_text() == (checkout / "double.py").read_text()
    with pytest.raises(RuntimeError, match="pytest: "):
        copy.failing(["test_nothing.py"])


@pytest.mark.slow
def test_a_test_that_is_red_without_an_error_catches_none(checkout, tmp_path, monkeypatch):
    (checkout / "test_double.py").write_text("def test_never():\n    assert False\n")
    copy = Copy(checkout, tmp_path / "copy")
    with pytest.raises(RuntimeError, match=r"test_double.py::test_never also fails without a planted error"):
        copy.plant(DOUBLE)
    monkeypatch.setattr("studies.planted.measure._copy", lambda: copy)
    assert planted(DOUBLE) == "part: halves: test_double.py::test_never also fails without a planted error"
    assert planted(DOUBLE, ["test_double.py::test_never"]).outcome == CAUGHT, "taken as green"


def test_an_error_without_its_place_is_told(checkout):
    wrong = [replace(DOUBLE, old="3 * x"), replace(DOUBLE, old="x"), replace(DOUBLE, tests=("test_other.py",))]
    lines = misplaced(checkout, wrong)
    assert "0 times" in lines[0] and "3 times" in lines[1] and lines[2] == "test_other.py is not a test file"


def test_changes_of_a_file_share_its_tests(tmp_path, monkeypatch):
    monkeypatch.setattr("studies.planted.measure.ERRORS", tmp_path)
    text = "- {file: a.py, tests: [test_beam.py, test_metrics.py], errors: [{error: one, old: x, new: y}, "
    (tmp_path / "part.yaml").write_text(text + "{error: two, old: u, new: v, equivalent: why}]}")
    tests = ("tests/test_beam.py", "tests/test_metrics.py")
    assert list(changes("part")) == [
        Change("part", "one", "a.py", "x", "y", tests), Change("part", "two", "a.py", "u", "v", tests, "why"),
    ]  # fmt: skip


def test_rows_with_an_old_column_name_are_refused_in_one_line(tmp_path):
    (tmp_path / "rows.csv").write_text("room,error,file,outcome,by,seconds\nmodel,halves,a.py,caught,b.py,2\n")
    line = f"{tmp_path / 'rows.csv'}: room is not a column of Planted; scripts/convert.py converts old keys"
    assert refusal(kept, tmp_path / "rows.csv") == line


def test_the_part_is_chosen_by_its_option(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["plant", "--part", "model", "--only", "no such text", "--folder", str(tmp_path)])
    assert command("plant").main() == 0
    assert "no error matches" in capsys.readouterr().out


def test_only_errors_without_a_row_of_the_present_code_run_again(tmp_path, monkeypatch, capsys):
    first, second, *_ = PARTS["model"]
    old = Planted(first.part, first.error, first.file, CAUGHT, "a test", 1.0, "of an older source")
    new = replace(old, part=second.part, error=second.error, code=code_of(second))
    rows = {(row.part, row.error): row for row in (old, new)}
    assert [is_current(change, rows) for change in PARTS["model"][:3]] == [False, True, False]
    write_rows([new], tmp_path / "planted.csv")
    monkeypatch.setattr("sys.argv", ["plant", "--only", second.error, "--folder", str(tmp_path)])
    assert command("plant").main() == 0
    assert "have rows of the present code" in capsys.readouterr().out


@pytest.mark.parametrize("edited", ["double.py", "test_double.py"])
def test_a_row_is_outdated_by_its_source_and_by_its_tests(checkout, tmp_path, edited):
    other = tmp_path / "edited"
    shutil.copytree(checkout, other)
    text = (other / edited).read_text()
    (other / edited).write_text(f"# a comment\n{text}")
    assert code_of(DOUBLE, other) == code_of(DOUBLE, checkout)
    edited_again = tmp_path / "again"
    shutil.copytree(checkout, edited_again)
    (edited_again / edited).write_text(text.replace("2", "3"))
    assert code_of(DOUBLE, edited_again) != code_of(DOUBLE, checkout)
    assert code_of(replace(DOUBLE, new="x / 3"), checkout) != code_of(DOUBLE, checkout)


def test_outdated_errors_are_counted_by_part(tmp_path, monkeypatch):
    monkeypatch.setattr("studies.planted.measure.PARTS", {"part": [DOUBLE, replace(DOUBLE, error="doubles")]})
    assert outdated(tmp_path) == ["part: 2 errors"]


@pytest.mark.slow
def test_the_test_that_caught_an_error_before_runs_first(checkout, tmp_path):
    (checkout / "test_other.py").write_text("import double\n\n\ndef test_two():\n    assert double.double(2) == 4\n")
    copy = Copy(checkout, tmp_path / "copy")
    assert copy.plant(replace(DOUBLE, first="test_other.py::test_two")).by == "test_other.py::test_two"
    blind = replace(DOUBLE, old="0 * abs(x)", new="abs(x - 1)", tests=("test_other.py",))
    assert copy.plant(replace(blind, first="test_double.py::test_one")).by == "test_other.py::test_two"
    assert copy.passing(["test_double.py", "test_other.py::test_two"]) == [
        "test_double.py::test_one", "test_other.py::test_two",
    ]  # fmt: skip


def test_an_earlier_test_that_is_gone_does_not_run():
    row = Planted("part", "halves", "double.py", CAUGHT, "studies/test_planted.py::test_that_is_gone[1]", 1.0)
    assert with_first_test(DOUBLE, row) == DOUBLE == with_first_test(DOUBLE, None)
    name = test_an_earlier_test_that_is_gone_does_not_run.__name__
    known = with_first_test(DOUBLE, replace(row, by=f"studies/test_planted.py::{name}[a case]"))
    assert known.first == f"tests/studies/test_planted.py::{name}"
