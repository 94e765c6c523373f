"""Tests of the verification table: fast rows pass, wrong values fail, and the page counts every row."""

from dataclasses import replace

import numpy as np
import pytest

from flexman_gym.toolbox.verification.table import VerificationRow, VerificationTable
from studies.files import read_rows
from studies.verification.arms import catalog_rows, rayleigh_frequencies
from studies.verification.motions import rows as table_rows
from studies.verification.page import page

from oracles.files import REFERENCE, ROOT

pytestmark = pytest.mark.slow

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
    assert len(rows) > 90 and VerificationTable(rows).exit_code == 0
    assert len({row.case for row in rows}) == len(rows)
    assert all(row.source for row in rows)


def test_a_printed_value_is_met_to_half_its_last_digit():
    for value, verdict in ((4.549, "pass"), (4.451, "pass"), (4.56, "fail"), (4.44, "fail")):
        assert VerificationRow.printed("a frequency, Hz", "a book", "4.5", value).verdict == verdict


def test_published_frequencies_are_those_of_the_catalog():
    result = list(catalog_rows())
    assert len(result) == 12
    assert [row.case for row in result if row.verdict == "fail"] == []
    shown = [row for row in result if row.tolerance is None]
    assert len(shown) == 1 and shown[0].error < 0.03


def test_the_page_counts_all_rows_with_a_verdict(rows):
    shown = [*rows, replace(ROW, tolerance=None), replace(ROW, computed=np.inf)]
    text = page(shown, {})
    cells = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")][2:]
    judged = [row for row in shown if row.tolerance is not None]
    assert sum(int(count) for _, count, *_ in cells) == len(judged)
    assert sum(int(passed) for _, _, passed, _ in cells) == len(judged) - 1
    assert f"**{len(judged) - 1} of {len(judged)} rows" in text


def test_the_catalog_rows_are_whole_and_have_no_failure(rows):
    published = read_rows(ROOT / "docs" / "evidence" / "verification.csv", VerificationRow)
    assert VerificationTable(published).exit_code == 0 and {row.case for row in rows} <= {row.case for row in published}


def test_rotary_inertia_lowers_the_eigenvalues_of_a_slender_beam():
    slender = (3.51601527, 22.03449156, 61.69721441)  # Blevins, 1979
    assert rayleigh_frequencies(3, 1e-12) == pytest.approx(slender, rel=1e-7)
    assert (rayleigh_frequencies(3, 1e-4) < slender).all()
