"""Planted errors: the table fits the sources, and the planter tells what is caught from what survives."""

import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from studies.planted.measure import CAUGHT, EQUIVALENT, ROOMS, SURVIVED, Change, Copy, changes, misplaced

ROOT = Path(__file__).parents[2]
DOUBLE = Change("room", "halves", "double.py", "2 * x", "x / 2", ("test_double.py",))


@pytest.fixture
def checkout(tmp_path):
    """A checkout of one function and its test; the folder of agents is there for their name."""
    folder = tmp_path / "checkout"
    (folder / "agents").mkdir(parents=True)
    (folder / "double.py").write_text("def double(x):\n    return 2 * x + 0 * abs(x)\n")
    (folder / "test_double.py").write_text("import double\n\n\ndef test_one():\n    assert double.double(1) == 2\n")
    (folder / "pyproject.toml").write_text('[tool.pytest.ini_options]\npythonpath = ["."]\n')
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    return folder


def test_every_error_of_the_table_has_its_place_and_its_tests():
    every = [change for room in ROOMS.values() for change in room]
    assert misplaced(ROOT, every) == []
    assert len(every) >= 120 and len({(change.room, change.error) for change in every}) == len(every)
    assert all(change.room == name for name, room in ROOMS.items() for change in room)


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
    with pytest.raises(RuntimeError, match="pytest says"):
        copy.failing(["test_nothing.py"])


def test_a_test_that_is_red_without_an_error_catches_none(checkout, tmp_path):
    (checkout / "test_double.py").write_text("def test_never():\n    assert False\n")
    copy = Copy(checkout, tmp_path / "copy")
    with pytest.raises(RuntimeError, match=r"test_double.py::test_never fails without an error too"):
        copy.plant(DOUBLE)


def test_an_error_without_its_place_is_told(checkout):
    wrong = [replace(DOUBLE, old="3 * x"), replace(DOUBLE, old="x"), replace(DOUBLE, tests=("test_other.py",))]
    lines = misplaced(checkout, wrong)
    assert "0 times" in lines[0] and "3 times" in lines[1] and lines[2] == "test_other.py is no test"


def test_changes_of_a_file_share_its_tests(tmp_path, monkeypatch):
    monkeypatch.setattr("studies.planted.measure.ERRORS", tmp_path)
    text = "- {file: a.py, tests: [test_beam.py, test_metrics.py], errors: [{error: one, old: x, new: y}, "
    (tmp_path / "room.yaml").write_text(text + "{error: two, old: u, new: v, equivalent: why}]}")
    tests = ("tests/test_beam.py", "tests/test_metrics.py")
    assert list(changes("room")) == [
        Change("room", "one", "a.py", "x", "y", tests), Change("room", "two", "a.py", "u", "v", tests, "why"),
    ]  # fmt: skip
