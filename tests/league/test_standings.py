"""Standing: made-up rows of known answer, scenario by scenario and on the whole, and the page that is made of them."""

import numpy as np
import pytest

from flexman_gym.evaluation.agent import BASELINES
from flexman_gym.league.page import CHART, PAGE, write_page
from flexman_gym.league.rows import VALUES, EpisodeBlock, EpisodeRow, LeagueRows
from flexman_gym.league.scenarios import LAB_SCENARIO
from flexman_gym.league.standings import Standings

NOMINAL, UNKNOWN, FRICTION = "FlexRRR-v0", "FlexRRR-v0/unknown", "FlexRRR-v0/friction"
REWARDS = {"zero": 100.0, "privileged-lqr": 300.0, "pd": 150.0, "lqg": 250.0, "lqr": 280.0}


def page_text(standings, folder):
    """Return the page of the rows of standings."""
    write_page(standings.results, folder)
    return (folder / PAGE).read_text(encoding="utf-8")


def recommended(standings, folder):
    """Return the recommendation of the page."""
    return page_text(standings, folder).partition("## Choose an agent\n")[2].partition("\n## ")[0].strip()


def book(rewards=REWARDS, scenarios=(NOMINAL, UNKNOWN, LAB_SCENARIO), settled=None, count=12, spread=10.0):
    """Episodes whose rewards lie evenly around those given; `settled`, (agent, scenario) -> time (s), 3 s without."""
    rows, cells = [], []
    for scenario in scenarios:
        for agent, reward in rewards.items():
            if reward is None:
                cells.append(EpisodeBlock("k", agent, scenario, 9000, 9000 + count, why="it has no model"))
                continue
            cells.append(EpisodeBlock("k", agent, scenario, 9000, 9000 + count, 12.0, 3000.0))
            for i, part in enumerate(np.linspace(-1.0, 1.0, count)):
                time = (settled or {}).get((agent, scenario), 3.0)
                values = dict.fromkeys(VALUES, 0.0) | {"reward": reward + spread * part, "settling_time": time}
                values |= {"settled": float(np.isfinite(time)), "multiple": time / 2.0}
                rows.append(EpisodeRow("k", agent, scenario, 9000 + i, tuple(values[name] for name in VALUES)))
    return LeagueRows(rows, cells)


def standing(*given, **more):
    """The standing of such a book."""
    return Standings(book(*given, **more))


def test_scores_lie_between_who_does_nothing_and_who_knows_all():
    known = standing()
    assert known.score("zero", NOMINAL)[0] == pytest.approx(0.0, abs=1e-12)
    assert known.score("privileged-lqr", NOMINAL)[0] == pytest.approx(1.0)
    assert known.score("pd", NOMINAL) == pytest.approx((0.25, 0.25, 0.25)), "episodes differ alike for all"
    assert known.overall["lqg"][0] == pytest.approx(0.75)
    assert known.agents == ["privileged-lqr", "lqr", "lqg", "pd", "zero"]


def test_of_two_scenarios_with_the_same_episodes_one_counts():
    assert standing().scenarios == [NOMINAL, UNKNOWN, LAB_SCENARIO] and standing().counted == [NOMINAL, UNKNOWN]


def test_there_is_no_scale_where_its_ends_are_close_or_missing(tmp_path):
    """A slew has 500 control periods, each worth 1 at most."""
    assert standing(REWARDS | {"privileged-lqr": 124.0}).scale(NOMINAL) is None
    assert standing(REWARDS | {"privileged-lqr": 126.0}).scale(NOMINAL) == pytest.approx((100.0, 126.0))
    missing = standing({"pd": 1.0, "zero": 2.0})
    assert missing.scale(NOMINAL) is None and missing.counted == [] and missing.score("pd", NOMINAL) is None
    assert "There is no score" in page_text(missing, tmp_path)


def test_better_is_asked_in_the_same_episode():
    known = standing()
    assert known.improvement_probability("lqg", "pd", [NOMINAL, UNKNOWN]) == (1.0, 1.0, 1.0)
    assert known.improvement_probability("pd", "lqg", [NOMINAL]) == (0.0, 0.0, 0.0)
    assert known.improvement_probability("pd", "lqr", ["nowhere"]) is None


def test_an_agent_that_misses_a_scenario_comes_last():
    one, two = book(), book({"optimised": 400.0}, [NOMINAL])
    known = Standings(LeagueRows([*one.rows.values(), *two.rows.values()], [*one.cells.values(), *two.cells.values()]))
    assert known.agents[-1] == "optimised" and known.missed("optimised") == [UNKNOWN]
    assert known.why("optimised", UNKNOWN) == "it was not run there" and known.why("optimised", NOMINAL) == ""
    assert known.overall["optimised"][0] == pytest.approx(1.5), "above 1 is shown"


def test_agents_without_common_episodes_are_not_compared(tmp_path):
    one, two = book({"zero": 100.0, "privileged-lqr": 300.0}), book({"pd": 200.0})
    moved = [row._replace(seed=row.seed + 1000) for row in two.rows.values()]
    known = Standings(LeagueRows([*one.rows.values(), *moved], [*one.cells.values(), *two.cells.values()]))
    assert known.score("pd", NOMINAL) is None and known.improvement_probability("pd", "zero", [NOMINAL]) is None
    assert "| `pd` |" in page_text(known, tmp_path)


def test_the_one_to_take_settles_most_and_first_and_is_given_no_truth(tmp_path):
    times = {("pd", LAB_SCENARIO): np.inf, ("lqg", LAB_SCENARIO): 4.0, ("lqr", LAB_SCENARIO): 2.0}
    times["lqg", FRICTION] = np.inf
    known = standing(scenarios=(NOMINAL, UNKNOWN, LAB_SCENARIO, FRICTION), settled=times)
    assert known.realisable(LAB_SCENARIO) == ["lqg", "pd"]
    said = recommended(known, tmp_path)
    assert said.startswith("For an arm with unknown payload, stiffness and delay (`FlexRRR-v0/unknown-lab`), use `lqg`")
    for words in ("settles 100 % of the episodes, half of them within 4.00 s", "needs: model",
                  "An action takes 12 microseconds, and the start of an episode 3 ms", "is `pd`. It settles 0 % of",
                  "true state and parameters is 3.00 s", "fails in `friction`"):  # fmt: skip
        assert words in said, words
    quicker = standing(settled={("pd", LAB_SCENARIO): 2.9})
    assert quicker.realisable(LAB_SCENARIO) == ["pd", "lqg"] and "fails in none" in recommended(quicker, tmp_path)
    assert "No agent that is realisable on hardware" in recommended(standing(scenarios=(NOMINAL,)), tmp_path)


def test_no_cell_of_the_page_is_empty_without_a_sentence(tmp_path):
    rows = book(REWARDS | {"lqr-tracking": None}, [NOMINAL, LAB_SCENARIO, "FlexRRR-Track-v0", "FlexRRR-v0/payload=25"])
    write_page(rows, tmp_path)
    text = (tmp_path / PAGE).read_text()
    for scenario in (NOMINAL, LAB_SCENARIO, "FlexRRR-Track-v0"):
        section = text.split(f"### {scenario}\n")[1].split("\n#")[0]
        for agent in REWARDS:
            assert f"| `{agent}` |" in section
        assert "`lqr-tracking` has no row: it has no model." in section
    assert "Not run at all: `lqr-tracking`." in text.split("## Sweep: FlexRRR-v0/payload")[1]
    cells = [cell.strip() for line in text.splitlines() if line.startswith("|") for cell in line.split("|")[1:-1]]
    assert cells and all(cells) and "nan" not in cells
    known = text.split("a wrong one here: ")[1].split(".")[0]
    assert "`lqg`" in known and "`privileged-lqr`" not in known and "`pd`" not in known


def test_each_is_compared_with_the_next(tmp_path):
    lines = page_text(standing(REWARDS | {"lqg": 280.0}), tmp_path).split("| agent | needs |")[1].splitlines()[2:7]
    assert [line.split("|")[1].strip(" `") for line in lines] == ["privileged-lqr", "lqg", "lqr", "pd", "zero"]
    assert [line.split("|")[5].strip() for line in lines] == ["100 %", "50 %", "100 %", "100 %", "-"]


def test_the_charts_are_there(tmp_path):
    pytest.importorskip("matplotlib")
    write_page(book(scenarios=(NOMINAL, UNKNOWN, "FlexRRR-v0/delay=0", "FlexRRR-v0/delay=1")), tmp_path)
    assert {path.name for path in tmp_path.glob("*.png")} == {CHART, "league-FlexRRR-v0-delay.png"}
    text = (tmp_path / PAGE).read_text()
    assert all(f"]({path.name})" in text for path in tmp_path.glob("*.png"))


def test_sweeps_go_from_the_smallest_value(tmp_path):
    names = [f"FlexRRR-v0/payload={value}" for value in (10, 5, 25)]
    (values,) = standing(scenarios=names).sweeps.values()
    assert [*values.items()] == [(names[1], 5.0), (names[0], 10.0), (names[2], 25.0)]
    more = [f"FlexRRR-v0/delay={value}+given" for value in (3, 0)]
    others = ["FlexRRR-v0/payload=5@finer", "FlexRRR-v0/payload=5:10", "FlexRRR-v0/method=gauss_2"]
    found = standing(scenarios=[*more, *others]).sweeps
    assert {name: [*values] for name, values in found.items()} == {"FlexRRR-v0/delay+given": more[::-1]}
    assert "## Sweep: FlexRRR-v0/delay+given" in page_text(standing(scenarios=more), tmp_path)


def test_other_plants_stand_beside_the_same_episodes_and_count_nowhere(tmp_path):
    names = [f"{NOMINAL}@{plant}" for plant in ("finer", "method")]
    one, two = book(settled={("lqr", NOMINAL): np.inf}, scenarios=[NOMINAL]), book(scenarios=names, count=4)
    at = VALUES.index("settling_time")
    for place, row in one.rows.items():
        if row.agent == "pd" and row.seed >= 9004:  # of episodes that no other plant has
            one.rows[place] = row._replace(values=(*row.values[:at], np.inf, *row.values[at + 1 :]))
    known = Standings(LeagueRows([*one.rows.values(), *two.rows.values()], [*one.cells.values(), *two.cells.values()]))
    assert known.scenarios == known.counted == [NOMINAL] and known.sweeps == {}
    assert known.plants == {NOMINAL: [NOMINAL, names[1], names[0]]}
    text = page_text(known, tmp_path).split("## Other plants")[1]
    assert "| agent | usual | method | finer |" in text and "4 episodes." in text
    assert "| `lqr` | 0 % | 100 %, 3.00 s | 100 %, 3.00 s |" in text
    assert "| `pd` | 100 %, 3.00 s | 100 %, 3.00 s | 100 %, 3.00 s |" in text
    assert "Not run yet." in page_text(standing(), tmp_path)


def test_baselines_without_a_row_are_named(tmp_path):
    glance = page_text(standing(), tmp_path).split("## Results at a glance")[1].split("## Agents")[0]
    absent = glance.split("Not run yet: ")[1].split(".")[0].split(", ")
    assert set(absent) == {f"`{each}`" for each in BASELINES if each not in REWARDS}


def test_every_agent_has_a_section(tmp_path):
    text = page_text(standing(), tmp_path).split("## Agents")[1].split("## Overall score")[0]
    for agent in REWARDS:
        card = text.split(f"### Agent: {agent}\n")[1].split("###")[0]
        for words in ("Kind: ", "Information needed: ", "Tuning or training: ", "It fails in"):
            assert words in card, (agent, words)
        assert ("An action takes" in card) == (agent != "zero")
