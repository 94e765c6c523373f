"""Tests of numbers in README and pages against the published rows."""

import re

import pytest
import yaml

from flexman_gym.league import page
from flexman_gym.league.rows import LeagueRows
from flexman_gym.league.scenarios import LAB_SCENARIO
from flexman_gym.league.standings import Standings
from flexman_gym.simulation.methods import DEFAULT_METHOD
from studies.files import read_rows
from studies.ringdown.measure import Errors, methods_table

from oracles.files import ROOT

ACCURACY = " ".join((ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8").split())


@pytest.fixture(scope="module")
def errors():
    """Return the errors of the default by kind of motion, at the end and after 1 s."""
    rows = read_rows(ROOT / "docs" / "accuracy.csv", Errors)
    return {(row.kind, row.time == 1.0): row for row in rows if row.method == rows[0].method}


def test_the_accuracy_of_the_default_is_that_of_its_rows(errors):
    for (kind, early), row in errors.items():
        if early and kind in ("impulse", "slew"):
            continue
        after = f"{row.time:g} s"
        energy = f"{100 * row.energy_median:.1f} % | {100 * row.energy_90:.1f} %"
        tip = f"{1e3 * row.tip_median:.2g} mm | {1e3 * row.tip_90:.2g} mm | {1e3 * row.tip_95:.2g} mm"
        assert f"| {kind} | {after} | {row.within:.0%} | {energy} | {tip} |" in ACCURACY, (kind, after, energy, tip)
    assert errors["release", False].arms == errors["both planes", False].arms >= 300


def test_the_other_methods_are_those_of_their_rows():
    rows = read_rows(ROOT / "docs" / "accuracy.csv", Errors)
    assert (rows[0].method, rows[0].step) == (DEFAULT_METHOD, 0.00667) and len(methods_table(rows)) == 2 + 6
    for line in methods_table(rows):
        assert line in ACCURACY


def test_the_entry_to_cite_is_that_of_the_file_beside_the_package():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "cite.md").read_text(encoding="utf-8")
    for name in ("title", "version", "license"):
        assert re.search(rf"{name} += {{{re.escape(str(cited[name]))}}}", page), name


FOLDER = ROOT / "docs" / "league"


def test_the_page_concludes_what_its_rows_say(tmp_path, monkeypatch):
    monkeypatch.setattr(page, "draw_charts", lambda *_: [])
    page.write_page(LeagueRows.load(FOLDER), tmp_path)
    written, published = ((each / "league.md").read_text(encoding="utf-8") for each in (tmp_path, FOLDER))
    start = "## Choose an agent"
    assert published[published.index(start) :].startswith(written[written.index(start) : written.index("## Results")])


def test_known_rows_come_out():
    """Compare with another study, within 3 percentage points and 0.1 s."""
    standing = Standings(LeagueRows.load(FOLDER))
    for entrant, venue, known in (("lqr-tracking", "FlexRRR-v0", 2.98), ("adaptive-lqr", LAB_SCENARIO, 3.62),
                                  ("privileged-lqr", "FlexRRR-v0/unknown", 3.58)):  # fmt: skip
        settled, time = standing.settled(entrant, venue)
        assert settled >= 0.97 and abs(-time - known) <= 0.1, (entrant, venue)
