"""Tests of the verification table: fast rows pass, wrong values fail, and the page has every row."""

from dataclasses import replace

import numpy as np
import pytest

from flexman_gym.verification.table import COLUMNS, VerificationRow, exit_code
from studies.verification.arms import printed_row, published_rows, rayleigh_frequencies
from studies.verification.motions import rows as table_rows
from studies.verification.page import markdown_page

from oracles.files import REFERENCE, ROOT

ROW = VerificationRow("a number, m", "a book", 2.0, 2.001, 1e-3)
# The reference scenes hold the printed area of link 1 and that of `one_link`, which no section can have.
pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")


@pytest.fixture(scope="module")
def rows():
    """Return all rows except those of the long motions."""
    return table_rows(REFERENCE, quick=True)


def test_the_fast_rows_pass(rows):
    assert [row for row in rows if row.verdict != "pass"] == [row for row in rows if row.tolerance is None]
    assert sum(row.tolerance is None for row in rows) <= 1
    assert len(rows) > 90 and exit_code(rows) == 0
    assert len({row.case for row in rows}) == len(rows)
    assert all(row.source for row in rows)


def test_a_printed_value_is_met_to_half_its_last_digit():
    for value, verdict in ((4.549, "pass"), (4.451, "pass"), (4.56, "fail"), (4.44, "fail")):
        assert printed_row("a frequency, Hz", "a book", "4.5", value).verdict == verdict


def test_published_frequencies_are_those_of_the_catalog():
    result = list(published_rows())
    assert len(result) == 12
    assert [row.case for row in result if row.verdict == "fail"] == []
    shown = [row for row in result if row.tolerance is None]
    assert len(shown) == 1 and shown[0].error < 0.03


def test_the_page_holds_all_rows(rows):
    shown = [*rows, replace(ROW, tolerance=None), replace(ROW, computed=np.inf)]
    lines = [line for line in markdown_page(shown).splitlines() if line.startswith("| ")]
    assert lines[0] == "| " + " | ".join(COLUMNS) + " |"
    assert len(lines) == 2 + len(shown)
    for row, line in zip(shown, lines[2:], strict=True):
        assert line.startswith(f"| {row.case} | {row.source} |") and line.endswith(f"| {row.verdict} |")


def test_the_page_in_docs_is_whole_and_has_no_failure(rows):
    lines = [line for line in (ROOT / "docs" / "evidence" / "verification.md").read_text(encoding="utf-8").splitlines()]
    table = [line for line in lines if line.startswith("| ")][2:]
    assert all(not line.endswith("| fail |") for line in table)
    assert {row.case for row in rows} <= {line.split(" | ")[0].removeprefix("| ") for line in table}


def test_rotary_inertia_lowers_the_eigenvalues_of_a_slender_beam():
    slender = (3.51601527, 22.03449156, 61.69721441)  # Blevins, 1979
    assert rayleigh_frequencies(3, 1e-12) == pytest.approx(slender, rel=1e-7)
    assert (rayleigh_frequencies(3, 1e-4) < slender).all()
