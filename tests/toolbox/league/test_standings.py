"""Standing: made-up rows of known answer, scenario by scenario and on the whole, and the page that is made of them."""

import re

import numpy as np
import pytest

from flexman_gym.common.plot_style import rgb
from flexman_gym.evaluation.agent_info import INFORMATION, describe_agent
from flexman_gym.evaluation.agent_spec import SIMPLE_AGENTS
from flexman_gym.evaluation.trained_agents import AGENTS
from flexman_gym.toolbox.league import charts
from flexman_gym.toolbox.league.charts import CHART, LABEL_DISTANCE, LINE_COLOURS, SWEEP_CHART
from flexman_gym.toolbox.league.details import league_details
from flexman_gym.toolbox.league.page import PAGE, write_page
from flexman_gym.toolbox.league.rows import LIMITED, VALUES, EpisodeBlock, EpisodeRow, LeagueRows
from flexman_gym.toolbox.league.scenarios import LAB_SCENARIO, SWEEPS, find_scenario
from flexman_gym.toolbox.league.standings import Standings

NOMINAL, UNKNOWN, FRICTION = "FlexRRR-v0", "FlexRRR-v0/unknown", "FlexRRR-v0/friction"
REWARDS = {"zero": 100.0, "privileged-lqr": 300.0, "pd": 150.0, "lqg": 250.0, "lqr": 280.0}


def page_text(standings, folder):
    """Return the page of the rows of standings."""
    write_page(standings.results, folder)
    return (folder / PAGE).read_text(encoding="utf-8")


def recommended(standings, folder):
    """Return the recommendation of the page on one line."""
    text = page_text(standings, folder).partition("## Choose an agent\n")[2].partition("\n\nThe table")[0]
    return " ".join(text.split())


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
                values = (
                    dict.fromkeys(VALUES, 0.0)
                    | dict.fromkeys(LIMITED, np.nan)
                    | {"reward": reward + spread * part, "settling_time": time}
                )
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


def test_there_is_no_scale_where_its_ends_are_close_or_missing():
    """A slew has 500 control periods, each worth 1 at most."""
    assert standing(REWARDS | {"privileged-lqr": 124.0}).scale(NOMINAL) is None
    assert standing(REWARDS | {"privileged-lqr": 126.0}).scale(NOMINAL) == pytest.approx((100.0, 126.0))
    missing = standing({"pd": 1.0, "zero": 2.0})
    assert missing.scale(NOMINAL) is None and missing.counted == [] and missing.score("pd", NOMINAL) is None
    assert "no score: the mean rewards" in league_details(missing, NOMINAL)[-1]


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
    assert "| `pd` |" in page_text(known, tmp_path) and table_of(league_details(known, NOMINAL))["pd"]["score"] == "-"


def test_the_one_to_take_settles_most_and_first_and_is_given_no_truth(tmp_path):
    times = {("pd", LAB_SCENARIO): np.inf, ("lqg", LAB_SCENARIO): 4.0, ("lqr", LAB_SCENARIO): 2.0}
    times["lqg", FRICTION] = np.inf
    known = standing(scenarios=(NOMINAL, UNKNOWN, LAB_SCENARIO, FRICTION), settled=times)
    assert known.realisable(LAB_SCENARIO) == ["lqg", "pd"]
    said = recommended(known, tmp_path)
    assert said.startswith(
        "For an arm with unknown payload and stiffness and a known delay (`FlexRRR-v0/unknown-lab`), use `lqg`"
    )
    for words in ("settles 100 % of the episodes, half of them within 4.00 s", "needs: model",
                  "An action takes 12 us of CPU time, and the start of an episode 3 ms", "is `pd`. It settles 0 % of",
                  "true state and parameters is 3.00 s"):  # fmt: skip
        assert words in said, words
    assert "fails in: friction" in league_details(known, "lqg")
    quicker = standing(settled={("pd", LAB_SCENARIO): 2.9})
    assert quicker.realisable(LAB_SCENARIO) == ["pd", "lqg"]
    assert "use `pd`" in recommended(quicker, tmp_path) and "fails in: no scenario" in league_details(quicker, "lqg")
    assert "No agent that is realisable on hardware" in recommended(standing(scenarios=(NOMINAL,)), tmp_path)


def cells_of(text):
    """Return the cells of the tables of a text in Markdown."""
    return [cell.strip() for line in text.splitlines() if line.startswith("|") for cell in line.split("|")[1:-1]]


def table_of(lines):
    """Return agent -> head -> cell of the details of a league, whose table may be continued below."""
    found, heads = {}, []
    for line in lines:
        name, *cells = re.split(r" {2,}", line)
        if name == "agent":
            heads = cells
        elif heads and len(cells) == len(heads):
            found.setdefault(name, {}).update(zip(heads, cells, strict=True))
    return found


def test_no_cell_of_a_table_is_empty(tmp_path):
    scenarios = [NOMINAL, UNKNOWN, LAB_SCENARIO, "FlexRRR-Track-v0", "FlexRRR-v0/payload=25"]
    known = standing(REWARDS | {"lqr-tracking": None}, scenarios)
    details = {name: "\n".join(league_details(known, name)) for name in [*scenarios, "overall", "FlexRRR-v0/payload="]}
    cells = cells_of(page_text(known, tmp_path))
    assert cells and all(cells) and "nan" not in cells
    for text in details.values():
        assert "nan" not in text.split() and max(map(len, text.splitlines()[1:-1])) <= 100
    for scenario in scenarios:
        assert REWARDS.keys() <= table_of(details[scenario].splitlines()).keys()
        assert "no row of lqr-tracking: it has no model" in details[scenario]
    wrong = details[UNKNOWN].split("designed for the nominal arm: ")[1]
    assert "lqg" in wrong and "privileged-lqr" not in wrong and "pd" not in wrong


def test_an_environment_with_limits_shows_the_largest_excess_of_each_agent(tmp_path):
    path = tmp_path / "limited.yaml"
    path.write_text("id: FlexRRR-v0\nlimits: {strain: 1.0e-4, on_violation: cost}\n")
    known = standing(scenarios=[NOMINAL, str(path)])
    for (scenario, agent, seed), row in known.results.rows.items():
        if scenario == str(path):
            excess = (seed - 9000) / 100.0 if agent == "pd" else 0.0
            new = dict(zip(VALUES, row.values, strict=True)) | {"excess": excess, "violations": 1e3 * (excess > 0.0)}
            known.results.rows[scenario, agent, seed] = row._replace(values=tuple(new.values()))
    cells = table_of(league_details(known, str(path)))
    assert float(cells["pd"]["excess"]) == 0.11 and float(cells["lqr"]["excess"]) == 0.0
    assert "excess" not in table_of(league_details(known, NOMINAL))["pd"]
    assert known.settling_text("pd", str(path)) == "100 %, 3.00 s, excess 11 %"
    assert known.settling_text("pd", NOMINAL) == "100 %, 3.00 s"


@pytest.mark.slow
def test_each_is_compared_with_the_next():
    table = table_of(league_details(standing(REWARDS | {"lqg": 280.0}), "overall"))
    assert [*table] == ["privileged-lqr", "lqg", "lqr", "pd", "zero"]
    assert [cells["better"] for cells in table.values()] == ["100 %", "50 %", "100 %", "100 %", "-"]


def test_agents_are_chosen_among_those_with_the_same_information(tmp_path):
    """lqr is faster in the known arm, lqr-tracking settles in the unknown one; pd is alone."""
    rewards = REWARDS | {"lqr-tracking": 290.0}
    times = {("lqr", NOMINAL): 1.0, ("lqr", UNKNOWN): np.inf, ("pd", NOMINAL): np.inf, ("pd", UNKNOWN): np.inf}
    table = page_text(standing(rewards, settled=times), tmp_path).partition("| given |")[2].partition("\n\n")[0]
    rows = [line.split("|")[1:6] for line in table.splitlines()[2:]]
    assert [[cell.strip(" `") for cell in row] for row in rows] == [
        ["measurements only", "pd", "0 %", "0 %", "12"],
        ["nominal model or data sheets", "lqg", "100 %, 3.00 s", "100 %, 3.00 s", "12"],
        ["true state", "lqr", "100 %, 1.00 s", "0 %", "12"],
        ["true state", "lqr-tracking", "100 %, 3.00 s", "100 %, 3.00 s", "12"],
        ["true state and parameters", "privileged-lqr", "100 %, 3.00 s", "100 %, 3.00 s", "12"],
    ]


def test_the_page_has_the_numbers_of_the_heat_map_as_a_table(tmp_path):
    """Agents in the order of their information; settled episodes, %, and median settling time, s."""
    times = {("lqr", NOMINAL): 1.0, ("pd", NOMINAL): np.inf}
    table = page_text(standing(settled=times), tmp_path).partition('<div class="narrow" markdown>')[2].split("\n\n")[1]
    rows = [[cell.strip(" `") for cell in line.split("|")[1:3]] for line in table.splitlines()]
    assert rows[0] == ["agent", NOMINAL] and not {"zero", "random"} & {agent for agent, _ in rows}
    found = dict(rows)
    assert (found["pd"], found["lqr"], found["privileged-lqr"]) == ("0", "100, 1.00", "100, 3.00")
    assert [agent for agent in found if agent in ("pd", "lqg", "lqr", "privileged-lqr")] == [
        "pd", "lqg", "lqr", "privileged-lqr",
    ]  # fmt: skip


def test_every_agent_has_a_kind_of_information():
    kinds = {agent: describe_agent(agent).kind for agent in AGENTS if agent not in SIMPLE_AGENTS}
    assert set(kinds.values()) == set(INFORMATION)
    assert kinds["pd"] == "measurements only" and kinds["lqg"] == "nominal model or data sheets"
    assert kinds["adaptive-lqr"] == kinds["lab-flexrrr"] == "model, ranges of the parameters"
    assert kinds["mpc"] == kinds["ppo-flexrrr"] == "true state"
    assert kinds["shaping-flexrrr"] == kinds["optimised"] == "true state and parameters"


@pytest.mark.slow
def test_the_charts_are_there(tmp_path):
    pytest.importorskip("matplotlib")
    known = book(scenarios=(NOMINAL, "FlexRRR-Track-v0", "FlexRRR-v0/delay=0", "FlexRRR-v0/delay=1"))
    write_page(known, tmp_path)
    assert {path.name for path in tmp_path.glob("*.svg")} == {CHART, SWEEP_CHART}
    text = (tmp_path / PAGE).read_text()
    assert all(f"]({path.name})" in text for path in tmp_path.glob("*.svg"))


def test_lines_of_sweeps_are_told_apart_on_white():
    """Contrast ratios of WCAG 2, at least 3, and labels at a distance."""
    for colour in LINE_COLOURS:
        part = rgb(colour) / 255.0
        linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
        assert 1.05 / (linear @ [0.2126, 0.7152, 0.0722] + 0.05) >= 3.0, colour
    for heights in ([1.0, 1.0, 0.97, 0.0, 0.0], [0.0] * 5, [1.0] * 5, [0.1, 0.5, 0.9, 0.5, 0.3]):
        placed = charts._spread_labels(np.array(heights), LABEL_DISTANCE)
        assert np.diff(np.sort(placed)).min() >= LABEL_DISTANCE - 1e-12
        assert placed.min() >= 0.0 and placed.max() <= 1.0
    assert charts._spread_labels(np.array([1.0, 0.2]), 0.1).tolist() == [1.0, 0.2]
    assert np.argsort(charts._spread_labels(np.array([1.0, 1.0, 0.0]), 0.1)).tolist() == [2, 1, 0], (
        "the first is at the top"
    )


def test_limits_of_a_sweep_are_the_values_at_which_most_episodes_settle(tmp_path):
    names = {f"FlexRRR-v0/payload={value}": value for value in (0, 5, 10, 15, 20)}
    times = {("pd", name): np.inf for name, value in names.items() if value in (0, 10)}
    times |= {("lqg", name): np.inf for name in names}
    known = standing(scenarios=[LAB_SCENARIO, *names], settled=times)
    agents = known.swept_agents()
    assert agents[0] == "privileged-lqr" and len(agents) == 4 and "zero" not in agents
    heads, _, line = page_text(known, tmp_path).partition("| swept ")[2].splitlines()[:3]
    found = dict(zip(heads.split("|")[1:], line.split("|")[2:], strict=False))
    found = {head.strip(" `"): cell.strip() for head, cell in found.items()}
    assert found["given"] == "0 to 20" and found["privileged-lqr"] == "0 to 20"
    assert found["pd"] == "5, 15 to 20" and found["lqg"] == "none"


def test_values_given_to_the_controllers_of_a_sweep():
    first = {name: f"FlexRRR-v0/{name}={change.values[0]:g}" for name, change in SWEEPS.items()}
    given = {name: find_scenario(scenario).given_values() for name, scenario in first.items()}
    assert given == {"payload": "0 to 20", "stiffness": "0.7 to 1.3", "delay": "0 to 2", "noise": "0.001",
                     "period": "the value", "bias": "the value", "lost": "0", "friction": "nominal"}  # fmt: skip
    assert find_scenario("FlexRRR-v0/delay=3+given").given_values() == "the value"


def test_a_page_without_a_run_keeps_the_computer_of_its_rows(tmp_path):
    write_page(book(), tmp_path, "processor A, numpy 1.2.3")
    text = (tmp_path / PAGE).read_text(encoding="utf-8")
    assert text.endswith("\nComputed with processor A, numpy 1.2.3.\n")
    assert page_text(standing(), tmp_path) == text
    (tmp_path / PAGE).unlink()
    assert "Computed with" not in page_text(standing(), tmp_path)


def test_sweeps_go_from_the_smallest_value():
    names = [f"FlexRRR-v0/payload={value}" for value in (10, 5, 25)]
    (values,) = standing(scenarios=names).sweeps.values()
    assert [*values.items()] == [(names[1], 5.0), (names[0], 10.0), (names[2], 25.0)]
    more = [f"FlexRRR-v0/delay={value}+given" for value in (3, 0)]
    others = ["FlexRRR-v0/payload=5@finer", "FlexRRR-v0/payload=5:10", "FlexRRR-v0/method=gauss_2"]
    found = standing(scenarios=[*more, *others]).sweeps
    assert {name: [*values] for name, values in found.items()} == {"FlexRRR-v0/delay+given": more[::-1]}
    assert league_details(standing(scenarios=more), "FlexRRR-v0/delay+given=")[0].split() == [
        "delay,",
        "control",
        "periods",
        "0",
        "3",
    ]


@pytest.mark.slow
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
    table = page_text(known, tmp_path).partition("| swept |")[2].splitlines()
    heads = [head.strip(" `") for head in table[0].split("|")]
    found = dict(zip(heads, [cell.strip() for cell in table[2].split("|")[2:]], strict=True))
    assert table[2].startswith(f"| `{NOMINAL}` @usual, @method, @finer | - |")
    assert found["pd"] == "100, 100, 100 %" and found["lqr"] == "0, 100, 100 %"
    assert "No sweep of a parameter" in page_text(standing(), tmp_path)
