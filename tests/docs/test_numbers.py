"""Tests of numbers in README and pages against the published rows."""

import re

import pytest
import yaml

from flexman_gym.league import page
from flexman_gym.league.rows import LeagueRows
from flexman_gym.league.scenarios import LAB_SCENARIO
from flexman_gym.league.standings import Standings
from flexman_gym.simulation import METHODS
from studies.fidelity.measure import FidelityRow as Choice
from studies.fidelity.page import CHEAP
from studies.files import read_rows
from studies.learning.measure import LearningRow as Run
from studies.methods import largest_growth
from studies.ringdown.measure import Errors

from oracles.files import ROOT

README = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
EVIDENCE = ROOT / "docs" / "evidence"


@pytest.fixture(scope="module")
def errors():
    """Return the errors of the default by kind of motion, at the end and after 1 s."""
    rows = read_rows(EVIDENCE / "accuracy.csv", Errors)
    return {(row.kind, row.time == 1.0): row for row in rows if row.method == rows[0].method}


def test_the_accuracy_of_the_default_is_that_of_its_rows(errors):
    released, bent = errors["release", False], errors["both planes", False]
    assert f"within 2 % in {100 * released.within:.0f} % of the cases after 3 s" in README
    assert f"({100 * bent.within:.0f} % from stretched postures" in README
    assert released.arms == bent.arms >= 300


def test_growth_of_extrapolated_vibrations_is_that_of_the_methods():
    growth = {n: 100 * (largest_growth(METHODS[f"extrapolated_euler_{n}"])[0] - 1) for n in range(3, 9)}
    assert sorted(growth.values()) == list(growth.values())
    assert f"grow by up to {growth[3]:.1f} % a step with order 3, {growth[8]:.1f} % with order 8" in README


def test_shares_of_choices_are_those_of_the_rows():
    plain, opened = (read_rows(EVIDENCE / f"{name}.csv", Choice) for name in ("fidelity", "fidelity_open"))
    met, cheap = ([sum(each) for each in zip(*((row.error <= row.tolerance, row.dearer <= CHEAP) for row in rows),
                                             strict=True)] for rows in (plain, opened))  # fmt: skip
    assert f"{met[0]} of {len(plain)} choices meet their tolerance, and {met[1]} cost at most twice" in README
    assert f"({cheap[0]} of {len(opened)} meet it, {cheap[1]} at most twice the cost)" in README


def test_minutes_of_training_are_those_of_the_rows():
    rows = [row for row in read_rows(ROOT / "docs" / "evidence" / "learning.csv", Run) if row.kind == "recipe"]
    minutes = sorted(row.cpu / 60 for row in rows if row.name == "ppo_on_pd_minute" and row.where == "as trained")
    told = re.search(r"\| PPO on the PD \| everything \| ([\d.]+) to ([\d.]+) minutes", README)
    assert [float(each) for each in told.groups()] == [round(minutes[0], 1), round(minutes[-1], 1)]


def test_the_entry_to_cite_is_that_of_the_file_beside_the_package():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "cite.md").read_text(encoding="utf-8")
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
