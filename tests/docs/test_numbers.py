"""Tests of numbers in README and pages against the published rows."""

import inspect
import re

import pytest
import yaml

import flexman_gym as fm
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.evaluation.policy_files import POLICIES
from flexman_gym.toolbox.league import page
from flexman_gym.toolbox.league.certificate_file import exceeded_limits
from flexman_gym.toolbox.league.rows import LeagueRows
from flexman_gym.toolbox.league.scenarios import LAB_SCENARIO
from flexman_gym.toolbox.league.standings import Standings
from studies.files import read_rows
from studies.markdown import WORDS, number_word
from studies.results import Results
from studies.safety.measure import SafetyRow

from oracles.files import ROOT


def test_the_entry_to_cite_is_that_of_the_file_beside_the_package():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "releases.md").read_text(encoding="utf-8")
    for name in ("title", "version", "license"):
        assert re.search(rf"{name} += {{{re.escape(str(cited[name]))}}}", page), name


DOCS = ROOT / "docs"
FOLDER = DOCS / "league"
PAGES = {str(path.relative_to(DOCS)): path.read_text(encoding="utf-8")
         for path in sorted(DOCS.rglob("*.md")) if path.name != "changelog.md"}  # fmt: skip
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_number_of_environments_on_pages_is_that_of_the_named_environments():
    word, places = number_word(len(NAMED_ENVIRONMENTS)), (PAGES["index.md"], PAGES["environments/index.md"])
    for text in places:
        assert re.findall(rf"\b({'|'.join(WORDS[2:])}|\d+) environments\b", text.lower()) == [word]


def test_a_page_that_uses_the_safety_filter_names_its_extra():
    for name, text in {**PAGES, "README.md": README}.items():
        if re.search(r"safety=True|safety: true", re.sub(r"^\|.*$", "", text, flags=re.MULTILINE)):
            assert "mpc]" in text, name
    for module in (fm.evaluate, fm.rollout):
        assert "`mpc`" in inspect.getdoc(module)


def test_the_limits_that_pages_name_for_the_study_are_those_of_the_environments():
    """The limits are arguments of `Limits`; the pages name strain and spring torque."""
    own = {name: set(each.study) - {"on_violation"} for name, each in NAMED_ENVIRONMENTS.items() if each.study}
    assert set().union(*own.values()) == {"strain", "spring_torque"} and "FlexRRR-v0" in own
    sentence = re.search(r'limits="study", safety=True\)`(.*?)\n\n', README, re.DOTALL)[1]
    assert "strain and spring torque" in sentence and "workspace" not in sentence


def test_sentences_about_the_filter_have_the_worst_rows_of_its_study():
    rows = read_rows(DOCS / "evidence" / "safety.csv", SafetyRow)
    text = " ".join(README.split())
    largest = max(row.largest for row in rows if row.condition in ("nominal", "uncertain"))
    assert f"by up to {100.0 * largest:.2g} %. Set the limits that much lower" in text
    for condition, words in (("nominal", "moves of the known arm"), ("uncertain", "with all parameters uncertain")):
        own = [row for row in rows if row.condition == condition]
        counts = [f"{sum(getattr(row, name) for row in own):.0f}" for name in ("violations", "moves")]
        assert f"{counts[0]} of {counts[1]} {words}" in text
    assert "under any agent" not in text and "limits that hold" not in PAGES["safety.md"]


@pytest.mark.slow
def test_the_readme_says_how_its_top_agent_fares_in_mujoco():
    results = Results().standings
    times = [*results.values("lab-flexrrr", "FlexRRR-v0@mujoco", "settling_time").values()]
    text = " ".join(README.split())
    assert f"settles in {sum(time < float('inf') for time in times)} of {len(times)} episodes of the known arm" in text
    assert f"{sum(map(bool, map(exceeded_limits, POLICIES)))} of {len(POLICIES)} exceed one of the limits" in text


def test_pages_of_the_arm_after_the_paper_say_how_it_differs():
    """Area of link 1, rotors and damping of the environment, and the area in the code of the theory."""
    named, printed = NAMED_ENVIRONMENTS["FlexRRR-v0"].arm, fm.catalog.paper_rrr()
    assert "the_paper.md#what-flexrrr-v0-changes-and-why" in PAGES["environments/FlexRRR.md"]
    text = " ".join(PAGES["the_paper.md"].split())
    assert named.links[0].area == printed.links[0].area and "the printed area of link 1" in text
    rotors = [arm.joints[0].rotor_inertia for arm in (printed, named)]
    assert f"| rotor inertia | not printed; {rotors[0]:g} kg m^2 | {rotors[1]:g} kg m^2 |" in text
    assert f"modal damping ratio {named.modal_damping_ratio:g}" in text and printed.modal_damping_ratio == 0.0
    theory = PAGES["theory.md"]
    assert 'paper_rrr("corrected")' in theory and "corrected area of link 1, 0.0028 m^2" in " ".join(theory.split())
    assert fm.catalog.paper_rrr("corrected").links[0].area == 0.0028


@pytest.mark.slow
def test_the_page_of_the_league_is_that_of_its_rows(tmp_path, monkeypatch):
    published = (FOLDER / "league.md").read_text(encoding="utf-8")
    (tmp_path / "league.md").write_text(published, encoding="utf-8")
    monkeypatch.setattr(page, "draw_charts", lambda *_: [])
    page.write_page(LeagueRows.load(FOLDER), tmp_path)
    assert (tmp_path / "league.md").read_text(encoding="utf-8") == published


@pytest.mark.slow
def test_known_rows_come_out():
    """Compare with another study, within 3 percentage points and 0.1 s."""
    standing = Standings(LeagueRows.load(FOLDER))
    for entrant, venue, known in (("lqr-tracking", "FlexRRR-v0", 2.98), ("adaptive-lqr", LAB_SCENARIO, 3.62),
                                  ("privileged-lqr", "FlexRRR-v0/unknown", 3.58)):  # fmt: skip
        settled, time = standing.settled(entrant, venue)
        assert settled >= 0.97 and abs(-time - known) <= 0.1, (entrant, venue)
