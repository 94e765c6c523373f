"""Tests of the form of a study: stored rows, chosen tables, pages from rows, exit status."""

from argparse import ArgumentParser
from dataclasses import dataclass

import pytest

from studies.evidence import ROOT, studies
from studies.files import made_comment, today
from studies.study import Study, Table

from oracles.files import STUDIES, runner


@dataclass(frozen=True)
class Square:
    """Number and its square."""

    number: float
    square: float


def squares(numbers):
    """Yield the rows of numbers."""
    return (Square(float(number), float(number**2)) for number in numbers)


def page(small, large, files):
    """Return the sum of all squares and the comments of both files."""
    return f"{sum(row.square for row in (*small, *large)):g}, {files}"


STUDY = Study(
    tables=(Table("small", Square), Table("large", Square, 2)),
    measure=lambda _: (squares((1, 2)), squares((111,))),
    pages={"page.md": page},
    charts=lambda folder, small, large: (folder / "chart").write_text(f"{len(small)} and {len(large)}"),
    report=lambda small, large: int(large[0].square > 1e4),
    comment=lambda _: "a computer",
)


def run(study, *arguments):
    """Return the exit status of a study."""
    parser = ArgumentParser()
    study.arguments(parser)
    return study.run(parser.parse_args(arguments))


@pytest.fixture
def measured(tmp_path):
    """Return the folder of a study that was run."""
    assert run(STUDY, "--folder", str(tmp_path)) == 1
    return tmp_path


def test_page_chart_and_exit_status_are_those_of_the_stored_rows(measured):
    small, large = made_comment("a computer", today(), 2), made_comment("a computer", today(), 1)
    assert (measured / "large.csv").read_text() == f"# {large}\nnumber,square\n1.1e+02,1.2e+04\n"
    files = {"small.csv": small, "large.csv": large}
    assert (measured / "page.md").read_text() == f"12005, {files}"  # 1 + 4 + 12000, of two digits
    assert (measured / "chart").read_text() == "2 and 1"


def test_a_redrawn_page_has_the_rows_of_the_files(measured):
    (measured / "large.csv").write_text("# another computer\nnumber,square\n3,9\n")
    assert run(STUDY, "--redraw", "--folder", str(measured)) == 0
    files = {"small.csv": made_comment("a computer", today(), 2), "large.csv": "another computer"}
    assert (measured / "page.md").read_text() == f"14, {files}"


def test_rows_of_tables_that_are_not_chosen_are_neither_computed_nor_written(measured):
    def forbidden():
        raise AssertionError("computed")
        yield

    small, before = (measured / "small.csv").read_bytes(), (measured / "large.csv").read_bytes()
    study = Study(STUDY.tables, lambda _: (forbidden(), squares((2,))), STUDY.pages)
    run(study, "--tables", "large", "--folder", str(measured))
    assert (measured / "small.csv").read_bytes() == small and (measured / "large.csv").read_bytes() != before


def test_a_table_without_rows_has_its_heads(tmp_path):
    run(Study((Table("none", Square),), lambda _: [()], comment=lambda _: "a computer"), "--folder", str(tmp_path))
    assert (tmp_path / "none.csv").read_text() == f"# {made_comment('a computer', today(), 0)}\nnumber,square\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_files_of_a_study_are_those_of_the_record_of_evidence(name):
    study, known = runner(name), studies()[name]
    rows, drawn = ({path for pattern in each for path in ROOT.glob(pattern)} for each in (known.rows, known.drawn))
    folder = ROOT / known.folder
    assert {folder / f"{table.file}.csv" for table in study.tables} == {each for each in rows if each.suffix == ".csv"}
    assert {folder / file for file in study.pages} == {each for each in drawn if each.suffix == ".md"}
