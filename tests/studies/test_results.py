"""Tests of results that several pages print: one stored row for each, with its number of episodes."""

import re
from dataclasses import replace

import pytest

from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.metrics import upper_median
from flexman_gym.toolbox.league import page as league_page
from flexman_gym.toolbox.league.rows import LeagueRows
from studies.control.cases import ControlRow
from studies.control.page import page as control_page
from studies.environments.measure import (
    ADAPTIVE,
    AGENTS,
    BASELINES,
    CONDITIONS,
    LONG_NAME,
    SHAPED,
    Baseline,
    baselines_of,
    condition_agents,
)
from studies.files import read_rows
from studies.results import BASELINE_FILE, DOCS, Results

from oracles.files import ROOT

PAGES = {name: (ROOT / name).read_text(encoding="utf-8")
         for name in ("README.md", "docs/results.md", "docs/environments/index.md", "docs/environments/FlexRRR.md",
                      "docs/evidence/control.md", "docs/league/league.md")}  # fmt: skip


FEW = "lqr", "FlexRRR-v0"  # agent and scenario with fewer episodes


@pytest.fixture(scope="module")
def results():
    """Return the published results."""
    return Results()


@pytest.mark.evidence
@pytest.mark.slow
def test_an_agent_in_an_environment_has_one_row(results):
    own = [row for row in read_rows(DOCS / BASELINE_FILE, Baseline) if row.baseline != LONG_NAME]
    agents = BASELINES | AGENTS
    assert all(results.standings.why(agents[row.baseline], row.environment) for row in own)
    assert len({(row.environment, row.baseline) for row in own}) == len(own)
    known = {(row.environment, row.baseline) for row in results.baselines() if row.baseline != LONG_NAME}
    plain = {each for each in known if "/" not in each[0]}
    assert plain == {(name, baseline) for name in NAMED_ENVIRONMENTS for baseline in baselines_of(name)}
    conditions = {each for each in known if "/" in each[0]}
    assert condition_agents("FlexGantry-v0").keys() == {"PD", SHAPED}
    assert condition_agents("FlexCrane-v0").keys() == {"PD", SHAPED, ADAPTIVE}
    assert conditions == {
        (f"{name}/{each}", agent)
        for name, every in CONDITIONS.items()
        for each in every
        for agent in condition_agents(name)
    }


def test_a_result_of_the_league_is_the_upper_median_of_its_rows(results):
    found, league = results.find("pd", "FlexRRR-v0"), results.standings
    vibrations = [*league.values("pd", "FlexRRR-v0", "vibration").values()]
    assert (found.vibration, found.episodes) == (upper_median(vibrations), len(vibrations))
    assert -league.settled("lqr-tracking", "FlexRRR-v0")[1] == results.find("lqr-tracking", "FlexRRR-v0").settling_time
    assert results.find("hinf", "FlexRRR-Track-v0") is None and results.find("zero", "FlexOne-v0") is not None


README, RESULTS, LEAGUE = "README.md", "docs/results.md", "docs/league/league.md"
GALLERY, FAMILY, CONTROL = "docs/environments/index.md", "docs/environments/FlexRRR.md", "docs/evidence/control.md"
PLACES = {  # quantity -> page -> pattern of its number
    "vibration of pd in FlexRRR-v0": {
        README: r"`pd`: [^|]*\|[^|]*\| 0 % \| (\d+) mm",
        RESULTS: r"`pd` \| FlexRRR-v0 .*?- \| (\d+) \|",
        FAMILY: r"\| PD \| 0 % \(.*?\) \| - \| (\d+) mm",
    },
    "settling time of lab-flexrrr in unknown-lab": {
        README: r"`lab-flexrrr`.*100 %, ([\d.]+) s",
        LEAGUE: r"half of them within ([\d.]+) s",
        CONTROL: r"one period of delay .*, ([\d.]+) s \|$",
    },
    "settling time of lqr-tracking in FlexRRR-v0": {
        README: r"`lqr-tracking`[^|]*\|[^|]*\| 100 %, ([\d.]+) s",
        RESULTS: r"`lqr-tracking` \| FlexRRR-v0 \|[^|]*\| 100 % \| ([\d.]+)",
        GALLERY: r"^\| \[FlexRRR-v0\].*100 % after ([\d.]+) s",
        FAMILY: r"\| tracking LQR \| 100 % \(.*?\) \| ([\d.]+) s",
    },
    "RMS error of pd in FlexRRR-Track-v0": {
        RESULTS: r"`FlexRRR-Track-v0` \| (\d+) mm",
        GALLERY: r"^\| \[FlexRRR-Track-v0\].*?RMS error (\d+) mm",
    },
}


@pytest.mark.evidence
@pytest.mark.parametrize("places", PLACES.values(), ids=PLACES)
def test_a_number_is_the_same_on_all_pages(places):
    found = {page: re.search(pattern, PAGES[page], re.MULTILINE) for page, pattern in places.items()}
    assert all(found.values()), found
    assert len({match[1] for match in found.values()}) == 1, {page: match[1] for page, match in found.items()}


def test_the_number_of_episodes_on_a_page_is_that_of_its_rows(results):
    rows = read_rows(DOCS / "evidence" / "control.csv", ControlRow)
    text = control_page([replace(row, episodes=7 if row.episodes == 100 else row.episodes) for row in rows], results)
    words = " ".join(text.split())
    assert "share of the 7 or 100 test episodes" in words
    assert (
        "| given: biased readings | 7 | 100 % (65 to 100) |" in words
        and "| extreme: noise 0.3 % | 40 |" in words
        and "with 40 episodes for each value" in words
    )
    assert "20 episodes each: `privileged-lqr`" in words
    assert all(f"(Wilson) of shares of {count} episodes" in words for count in (40, 100))


@pytest.mark.slow
def test_the_page_of_the_league_has_the_numbers_of_episodes_of_its_rows(results, tmp_path, monkeypatch):
    """Sweeps and other plants may have fewer episodes than scenarios, and single agents fewer than others."""

    def end(row):
        return 9003 if "=" in row.scenario else 9006 if "@" in row.scenario else 9050 if row[1:3] == FEW else 9100

    rows = [row for row in results.standings.results.rows.values() if row.seed < end(row)]
    monkeypatch.setattr(league_page, "draw_charts", lambda *_: [])
    league_page.write_page(LeagueRows(rows, results.standings.results.cells.values()), tmp_path)
    words = " ".join((tmp_path / league_page.PAGE).read_text(encoding="utf-8").split())
    assert "the same 100 episodes of each scenario (" in words and "`lqr` in `FlexRRR-v0`: 50" in words
    assert "of shares of 100 episodes: " in words and "of shares of 6 episodes: " in words
    assert "at least 95 % of the 3 episodes settle" in words and "of the same 6 episodes in other simulations" in words
