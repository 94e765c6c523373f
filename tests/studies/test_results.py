"""Tests of results that several pages print: one stored row for each, with its number of episodes."""

import re
from dataclasses import replace

import pytest

from flexman_gym.envs import NAMED_ENVIRONMENTS
from flexman_gym.league.rows import LeagueRows
from flexman_gym.league.standings import Standings
from flexman_gym.metrics import upper_median
from studies.control.cases import ControlRow
from studies.control.page import page as control_page
from studies.environments.measure import BASELINES, LONG_NAME, Baseline
from studies.files import read_rows
from studies.results import BASELINE_FILE, DOCS, Results

from oracles.files import ROOT

PAGES = {name: (ROOT / name).read_text(encoding="utf-8")
         for name in ("README.md", "docs/results.md", "docs/environments/index.md", "docs/environments/FlexRRR.md",
                      "docs/evidence/control.md", "docs/league/league.md")}  # fmt: skip


@pytest.fixture(scope="module")
def results():
    """Return the published results."""
    return Results()


def test_an_agent_in_an_environment_has_one_row(results):
    own = [row for row in read_rows(DOCS / BASELINE_FILE, Baseline) if row.baseline != LONG_NAME]
    assert all(results.standings.why(BASELINES[row.baseline], row.environment) for row in own)
    assert len({(row.environment, row.baseline) for row in own}) == len(own)
    known = {(row.environment, row.baseline) for row in results.baselines() if row.baseline != LONG_NAME}
    assert known == {(name, baseline) for name in NAMED_ENVIRONMENTS for baseline in BASELINES}


def test_a_result_of_the_league_is_the_upper_median_of_its_rows(results):
    found, league = results.find("pd", "FlexRRR-v0"), results.standings
    vibrations = [*league.values("pd", "FlexRRR-v0", "vibration").values()]
    assert (found.vibration, found.episodes) == (upper_median(vibrations), len(vibrations))
    assert -league.settled("lqr-tracking", "FlexRRR-v0")[1] == results.find("lqr-tracking", "FlexRRR-v0").settling_time
    assert results.find("hinf", "FlexRRR-Track-v0") is None and results.find("zero", "FlexOne-v0") is not None


@pytest.mark.parametrize(
    ("agent", "scenario", "places"),
    [
        ("pd", "FlexRRR-v0", {"README.md": r"`pd`: [^|]*\|[^|]*\| 0 % \| (\d+) mm", "docs/results.md": r"`pd` \| FlexRRR-v0 .*?- \| (\d+) \|",
                              "docs/environments/FlexRRR.md": r"\| PD \| 0% \| - \| (\d+) mm"}),
        ("lab-flexrrr", "FlexRRR-v0/unknown-lab", {"README.md": r"`lab-flexrrr`.*100 %, ([\d.]+) s", "docs/league/league.md": r"half of them within ([\d.]+) s",
                                                   "docs/evidence/control.md": r"one period of delay .*, ([\d.]+) s \|$"}),
        ("lqr-tracking", "FlexRRR-v0", {"README.md": r"`lqr-tracking`[^|]*\|[^|]*\| 100 %, ([\d.]+) s", "docs/results.md": r"`lqr-tracking` \| FlexRRR-v0 \|[^|]*\| 100 % \| ([\d.]+)",
                                        "docs/environments/index.md": r"^\| \[FlexRRR-v0\].*100% after ([\d.]+) s",
                                        "docs/environments/FlexRRR.md": r"\| tracking LQR \| 100% \| ([\d.]+) s"}),
        ("pd", "FlexRRR-Track-v0", {"docs/results.md": r"`FlexRRR-Track-v0` \| (\d+) mm", "docs/environments/index.md": r"^\| \[FlexRRR-Track-v0\].*?RMS error (\d+) mm"}),
    ],
)  # fmt: skip
def test_a_number_is_the_same_on_all_pages(agent, scenario, places):
    """Each pattern finds the number of the quantity on a page."""
    found = {page: re.search(pattern, PAGES[page], re.MULTILINE) for page, pattern in places.items()}
    assert all(found.values()), found
    assert len({match[1] for match in found.values()}) == 1, {page: match[1] for page, match in found.items()}


def test_the_number_of_episodes_on_a_page_is_that_of_its_rows(results):
    rows = read_rows(DOCS / "evidence" / "control.csv", ControlRow)
    text = control_page([replace(row, episodes=7 if row.episodes == 100 else row.episodes) for row in rows], results)
    assert "of 7 or 100 episodes where no other number" in " ".join(text.split())
    assert "have 40 episodes, each random arm 20" in " ".join(text.split())


def test_the_page_of_the_league_has_the_numbers_of_episodes_of_its_rows(results):
    """Sweeps and other plants may have fewer episodes than scenarios, and single agents fewer than others."""
    from flexman_gym.league.page import _page_text

    few = {key: row for key, row in results.standings.results.rows.items() if "=" not in row.scenario or row.seed < 9003}
    few = {key: row for key, row in few.items() if "@" not in row.scenario or row.seed < 9006}
    few = {key: row for key, row in few.items() if (row.agent, row.scenario) != ("lqr", "FlexRRR-v0") or row.seed < 9050}
    text = _page_text(Standings(LeagueRows(few.values(), results.standings.results.cells.values())))
    words = " ".join(text.split())
    assert "the same 100 episodes of each scenario (" in words and "`lqr` in `FlexRRR-v0`: 50" in words
    assert "at least 95 % of the 3 episodes settle" in words and "of the same 6 episodes in other simulations" in words
