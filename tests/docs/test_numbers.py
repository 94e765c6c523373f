"""Tests of numbers in README and pages against the published rows."""

import re

import yaml

from flexman_gym.league import page
from flexman_gym.league.rows import LeagueRows
from flexman_gym.league.scenarios import LAB_SCENARIO
from flexman_gym.league.standings import Standings

from oracles.files import ROOT


def test_the_entry_to_cite_is_that_of_the_file_beside_the_package():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "releases.md").read_text(encoding="utf-8")
    for name in ("title", "version", "license"):
        assert re.search(rf"{name} += {{{re.escape(str(cited[name]))}}}", page), name


FOLDER = ROOT / "docs" / "league"


def test_the_page_of_the_league_is_that_of_its_rows(tmp_path, monkeypatch):
    published = (FOLDER / "league.md").read_text(encoding="utf-8")
    (tmp_path / "league.md").write_text(published, encoding="utf-8")
    monkeypatch.setattr(page, "draw_charts", lambda *_: [])
    page.write_page(LeagueRows.load(FOLDER), tmp_path)
    assert (tmp_path / "league.md").read_text(encoding="utf-8") == published


def test_known_rows_come_out():
    """Compare with another study, within 3 percentage points and 0.1 s."""
    standing = Standings(LeagueRows.load(FOLDER))
    for entrant, venue, known in (("lqr-tracking", "FlexRRR-v0", 2.98), ("adaptive-lqr", LAB_SCENARIO, 3.62),
                                  ("privileged-lqr", "FlexRRR-v0/unknown", 3.58)):  # fmt: skip
        settled, time = standing.settled(entrant, venue)
        assert settled >= 0.97 and abs(-time - known) <= 0.1, (entrant, venue)
