"""League: rows are those of a rollout, to the bit the same however they are computed, and a killed league resumes."""

import csv
import json
import shutil
from dataclasses import astuple, replace
from types import SimpleNamespace

import numpy as np
import pytest

import flexman_gym.toolbox.league.rows as league
from flexman_gym.agent.base_controllers import BASES
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation import action_clock
from flexman_gym.evaluation.action_clock import ActionClock, TimedMode
from flexman_gym.evaluation.agent_info import check_seeds_unseen, describe_agent, training_seconds
from flexman_gym.evaluation.agent_spec import BASELINES, AgentSpec
from flexman_gym.evaluation.metrics import LIMIT_METRICS, METRICS
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS, EpisodeRecord, rollout, training_seed
from flexman_gym.toolbox.controllers.references.optimised_slews import SHIPPED_TABLE, SlewTable
from flexman_gym.toolbox.league.rows import (
    LIMITED,
    ROWS,
    TIME_RATIO,
    VALUES,
    EpisodeBlock,
    LeagueRows,
    optimised_settling_times,
    run_league,
)
from flexman_gym.toolbox.league.scenarios import SWEEPS, USUAL_SCENARIOS, Scenario, find_scenario

from oracles.assertions import refusal

AGENTS, SEEDS = ["zero", "random", "pd", "lqr-tracking"], range(9000, 9005)


@pytest.fixture
def scenario(tmp_path):
    """An environment that takes little time, as a file."""
    path = tmp_path / "one.yaml"
    path.write_text("id: FlexOne-v0\nhorizon: 1.5\nrandomisation: {sensor_noise: [0.001, 0.001]}\n")
    return str(path)


@pytest.fixture
def small_blocks(monkeypatch):
    """Two episodes a cell."""
    monkeypatch.setattr(league, "BLOCK", 2)


def league_of(scenario, folder, agents=AGENTS, jobs=1, seeds=SEEDS):
    """What a league said, and its rows as bytes."""
    said = []
    run_league(agents, [scenario], seeds, folder, jobs, said.append)
    return said, (folder / ROWS).read_bytes()


@pytest.mark.slow
def test_rows_hold_the_figures_of_a_rollout_to_the_bit(scenario, tmp_path):
    league_of(scenario, tmp_path, ["pd", "privileged-lqr"])
    with (tmp_path / ROWS).open(newline="") as file:
        rows = [*csv.DictReader(file)]
    assert len(rows) == 10
    for agent in ("pd", "privileged-lqr"):
        ours = [row for row in rows if row["agent"] == agent]
        assert [int(row["seed"]) for row in ours] == [*SEEDS]
        records = rollout(agent, scenario, SEEDS).records
        for name, metric in METRICS.items():
            assert [float(row[name]) for row in ours] == metric.values(records).tolist(), name
    assert all(row[TIME_RATIO] == "nan" for row in rows), "no table has slews of this one"
    assert all(row[name] == "nan" for row in rows for name in LIMITED), "it has no limits"


def test_rows_of_an_environment_with_limits_hold_its_violations(tmp_path):
    path = tmp_path / "limited.yaml"
    path.write_text("id: FlexOne-v0\nhorizon: 1.5\nlimits: {spring_torque: 0.5, on_violation: cost}\n")
    _, rows = EpisodeBlock("", "lqr", str(path), 9000, 9003).run()
    records = rollout("lqr", str(path), range(9000, 9003)).records
    for metric in LIMIT_METRICS:
        values = [row.values[VALUES.index(metric.name)] for row in rows]
        assert values == metric.values(records).tolist() and max(values) > 0.0, metric.name


@pytest.mark.slow
def test_rows_are_the_same_in_repeats_and_over_two_processes(scenario, tmp_path, small_blocks):
    said, rows = league_of(scenario, tmp_path / "a")
    assert len(said) == 4 * 3, "cells of two, two and one episode"
    assert league_of(scenario, tmp_path / "b")[1] == rows
    assert league_of(scenario, tmp_path / "c", jobs=2)[1] == rows
    assert league_of(scenario, tmp_path / "a") == ([], rows), "nothing is left"


@pytest.mark.slow
def test_a_killed_league_goes_on(scenario, tmp_path, small_blocks):
    def kill(said):
        if said.startswith("5 of"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_league(AGENTS, [scenario], SEEDS, tmp_path / "a", 1, kill)
    said, rows = league_of(scenario, tmp_path / "a")
    assert len(said) == 12 - 5 and rows == league_of(scenario, tmp_path / "b")[1]


def test_a_new_agent_runs_alone_and_more_episodes_are_those_that_miss(scenario, tmp_path, small_blocks):
    league_of(scenario, tmp_path, ["zero"], seeds=range(9000, 9004))
    said, _ = league_of(scenario, tmp_path, ["zero", "pd"], seeds=range(9000, 9006))
    assert [each.split(": ")[1].partition(" on")[0] for each in said] == ["zero", "pd", "pd", "pd"]
    assert len(LeagueRows.load(tmp_path).rows) == 12


def test_a_block_that_was_short_is_run_whole(scenario, tmp_path):
    league_of(scenario, tmp_path, ["pd"], seeds=range(9000, 9002))
    said, rows = league_of(scenario, tmp_path, ["pd"])
    assert len(said) == 1 and len(LeagueRows.load(tmp_path).rows) == 5
    assert league_of(scenario, tmp_path, ["pd"], seeds=range(9000, 9002)) == ([], rows), "fewer are there already"


def test_another_environment_by_the_same_name_is_run_anew(scenario, tmp_path):
    before = league_of(scenario, tmp_path / "a", ["zero", "pd"])[1]
    (tmp_path / "one.yaml").write_text("id: FlexOne-v0\nhorizon: 1.0\n")
    said, after = league_of(scenario, tmp_path / "a", ["pd"], seeds=range(9000, 9002))
    assert len(said) == 1 and after != before
    kept = {(row.agent, row.seed) for row in LeagueRows.load(tmp_path / "a").rows.values()}
    assert kept == {("zero", seed) for seed in SEEDS} | {("pd", 9000), ("pd", 9001)}, "no row of the old one"


def test_a_league_that_is_killed_between_its_files_misses_no_row(scenario, tmp_path, monkeypatch):
    """Rows come first: a cell in the file has them."""

    def write(path, fill):
        if path.name == league.CELLS:
            raise KeyboardInterrupt
        true_write(path, fill)

    true_write = league.write_atomically
    monkeypatch.setattr(league, "write_atomically", write)
    with pytest.raises(KeyboardInterrupt):
        league_of(scenario, tmp_path / "a", ["pd"])
    monkeypatch.undo()
    assert league_of(scenario, tmp_path / "a", ["pd"])[1] == league_of(scenario, tmp_path / "b", ["pd"])[1]


def test_another_version_of_a_package_runs_again(scenario, tmp_path, monkeypatch):
    league_of(scenario, tmp_path, ["zero"])
    assert league_of(scenario, tmp_path, ["zero"])[0] == []
    monkeypatch.setattr(league, "computer_info", lambda *_: {"numpy": "0.1"})
    assert len(league_of(scenario, tmp_path, ["zero"])[0]) == 1


def test_other_code_runs_again(scenario, tmp_path, monkeypatch):
    league_of(scenario, tmp_path, ["zero"])
    monkeypatch.setattr(league, "_code_hash", lambda *_: "another")
    assert len(league_of(scenario, tmp_path, ["zero"])[0]) == 1


@pytest.mark.slow
def test_the_hash_of_the_code_is_that_of_what_runs(tmp_path, tmp_path_factory, monkeypatch):
    for name in ("kernels/a.py", "envs/conditions/b.yaml", "evaluation/rollout.py", "league/page.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("a = 1\n")
    monkeypatch.setattr(league, "SOURCES", ("kernels", "envs", "evaluation/rollout.py"))
    copies = tmp_path_factory.mktemp("copies")

    def digest():
        """Return the key of a row with the code of a copy: a hash of a folder is computed once."""
        monkeypatch.setattr(league, "PACKAGE", shutil.copytree(tmp_path, copies / str(len([*copies.iterdir()]))))
        return league._row_key("pd", "FlexOne-v0")

    known = digest()
    (tmp_path / "league/page.py").write_text("another page")
    (tmp_path / "kernels/a.py").write_text('"""Other words."""\n\na = 1  # and a reason\n"""Of a number."""\n')
    assert digest() == known, "words alone are other ones"
    for name in ("kernels/a.py", "envs/conditions/b.yaml", "evaluation/rollout.py"):
        (tmp_path / name).write_text("a = 2\n")
        assert digest() != known, name
        (tmp_path / name).write_text("a = 1\n")
    (tmp_path / "kernels/a.py").rename(tmp_path / "kernels/c.py")
    assert digest() != known
    monkeypatch.undo()
    assert all((league.PACKAGE / name).exists() for name in league.SOURCES)


def test_the_equivalent_damping_is_that_of_the_swings_after_the_arrival():
    """A slew of 1 s that crosses the target, then a decay of one mode along y; the target is at its place of rest."""
    time, ratio = np.arange(0.0, 8.0, 0.02), 0.06
    after = 0.3 * np.exp(-ratio * 6.0 * time) * np.sin(np.sqrt(1.0 - ratio**2) * 6.0 * time)
    along = np.concatenate([np.linspace(2.0, 0.0, 50)[:-1], after])
    tips = np.stack([0.1 * along, along, np.zeros_like(along)], axis=1)

    def damping(tips, failure=""):
        errors = np.linalg.norm(tips, axis=1)
        return EpisodeRecord(tips, errors, tips[1:], errors[1:], failure, 0.02, 0.02).equivalent_damping()

    assert damping(tips) == pytest.approx(ratio, rel=0.01)
    assert damping(tips, "joint 1") == 0.0 and damping(tips + np.array([0.0, 0.0, 1.0])) == 0.0
    assert damping(np.vstack([tips[:50], np.zeros((50, 3))])) == np.inf, "it stops without a swing"


def test_a_book_reads_what_it_wrote(tmp_path):
    values = (np.inf, np.nan, 0.1 + 0.2, *map(float, range(3, len(VALUES))))
    rows = [league.EpisodeRow("k", "pd", "a, b", seed, values) for seed in (3, 2)]
    cells = [EpisodeBlock("k", "pd", "a, b", 2, 4, 1.5, 0.0), EpisodeBlock("k", "lqr", "a, b", 2, 4, why='it, "that"')]
    results = LeagueRows(rows, cells)
    results.save(tmp_path)
    again = LeagueRows.load(tmp_path)
    assert repr(sorted(again.rows.items())) == repr(sorted(results.rows.items())), "infinite ones and nan, too"
    assert repr(sorted(again.cells.items())) == repr(sorted(results.cells.items()))
    assert LeagueRows.load(tmp_path / "nowhere").rows == {}


ROW, CELL = "key,agent,scenario,seed", "key,agent,scenario,first,end,action,design,why"


def book_of(folder, rows=ROW, cells=CELL):
    """Write the two files of a league, and read them."""
    for name, text in ((ROWS, rows), (league.CELLS, cells)):
        (folder / name).write_text(text + "\n")
    return LeagueRows.load(folder)


def test_values_of_old_rows_stay_right_whatever_metrics_a_league_has_now(tmp_path, monkeypatch):
    """A metric that came later is nan in them, and their order is free; a column of no metric is refused."""
    written = {name: 0.5 + i for i, name in enumerate(VALUES)}
    LeagueRows(
        [league.EpisodeRow("k", "pd", "a", 7, tuple(written.values()))], [EpisodeBlock("k", "pd", "a", 7, 8)]
    ).save(tmp_path)
    monkeypatch.setattr(league, "VALUES", VALUES[1:])
    with pytest.raises(ValueError, match=rf"rows\.csv: {VALUES[0]} is no head of a league"):
        LeagueRows.load(tmp_path)
    now = ("new", *reversed(VALUES[1:]), "newer", VALUES[0])
    monkeypatch.setattr(league, "VALUES", now)
    results = LeagueRows.load(tmp_path)
    for _ in range(2):
        (row,) = results.rows.values()
        assert repr(row.values) == repr(tuple(written.get(name, float("nan")) for name in now))
        results.save(tmp_path)
        results = LeagueRows.load(tmp_path)


@pytest.mark.parametrize(
    ("rows", "cells", "said"),
    [
        ("", CELL, "rows.csv: its heads are not those of a league; give key, agent, scenario, seed and the metrics"),
        (ROW, "", "cells.csv: its heads are not those of a league; give key, agent, scenario, first, end"),
        ("key,agent,scenario", CELL, "rows.csv: its heads"),
        (f"{ROW},seed", CELL, "rows.csv: its heads"),
        (f"{ROW},root:x:0", CELL, "rows.csv: its heads"),
        (ROW, CELL.removesuffix(",why"), "cells.csv: its heads"),
        (ROW, f"{CELL},more", "cells.csv: more is no head of a league"),
        (f"{ROW},reward\nk,pd,a,1", CELL, "rows.csv: line 2 is not one of a league; give 5 entries"),
        (f"{ROW}\nk,pd,a,1\nk,pd,a,1,2", CELL, "rows.csv: line 3 is not one of a league; give 4 entries"),
        (f"{ROW}\nk,pd,a,\N{SUPERSCRIPT TWO}", CELL, "rows.csv: line 2"),
        (f"{ROW},reward\nk,pd,a,1,much", CELL, "rows.csv: line 2"),
        (ROW, f"{CELL}\nk,pd,a,0,b,0,0,", "cells.csv: line 2 is not one of a league; give 8 entries"),
    ],
)
def test_files_that_are_no_league_are_refused_in_one_line(tmp_path, rows, cells, said):
    line = refusal(book_of, tmp_path, rows, cells)
    assert line.startswith(f"{tmp_path}/{said}") and "root" not in line.removeprefix(str(tmp_path))
    assert book_of(tmp_path).rows == book_of(tmp_path).cells == {}


def test_a_controller_without_a_description_fails_at_import():
    """The entry of BASES is constructed when its module is imported."""
    entry = BASES["pd"]
    with pytest.raises(TypeError, match="description"):
        type(entry)(entry.make, entry.information, entry.arguments)


def test_who_cannot_run_says_why(scenario):
    cell, rows = EpisodeBlock("", "optimised", scenario, 9000, 9001).run()
    assert rows == [] and cell.why.startswith("table: only a table of this arm") and np.isnan(cell.action)
    for agent, words in (
        ("lqr", "it needs information that a laboratory cannot measure"),
        ("optimised", "it needs information"),
    ):
        assert EpisodeBlock("", agent, "FlexPlanar-v0/unknown-lab", 9000, 9001).run()[0].why.startswith(words)


def test_times_of_a_cell_are_of_a_start_and_of_an_action_of_one_arm(scenario, monkeypatch):
    """Ten milliseconds of starts in five episodes, and a second of actions in all of their periods."""
    clock = SimpleNamespace(start_seconds=0.01, action_seconds=1.0)
    monkeypatch.setattr(AgentSpec, "timed", lambda agent, environment: (agent, clock))
    cell, _ = EpisodeBlock("", "zero", scenario, 9000, 9005).run()
    assert cell.design == pytest.approx(1e6 * 0.01 / 5)
    assert cell.action == pytest.approx(1e6 * 1.0 / rollout("zero", scenario, SEEDS).lengths.sum())


def test_the_multiple_is_the_settling_time_in_those_of_the_slew(scenario, monkeypatch):
    """A tip that arrives after 1 s, where the slew takes 0.5 s, and in an episode of which there is no slew."""
    errors = np.where(np.arange(301) < 100, 1.0, 0.0)
    record = EpisodeRecord(np.zeros((301, 3)), errors, np.zeros((300, 1)), np.zeros(300), "", 0.01, 0.01)
    monkeypatch.setattr(league, "rollout", lambda *_, **__: SimpleNamespace(records=[record] * 2, lengths=[300] * 2))
    monkeypatch.setattr(league, "optimised_settling_times", lambda environment: {9000: 0.5})
    _, rows = EpisodeBlock("", "zero", scenario, 9000, 9002).run()
    multiples = [row.values[VALUES.index(TIME_RATIO)] for row in rows]
    assert multiples == pytest.approx([2.0, np.nan], nan_ok=True)


def test_both_ends_of_the_score_are_run_in_a_laboratory(monkeypatch):
    """Rewards are scaled between them; who else needs the true state is left out."""

    def refuse(agent, environment):
        raise ValueError("it is made")

    monkeypatch.setattr(AgentSpec, "timed", refuse)
    why = {
        who: EpisodeBlock("", who, "FlexPlanar-v0/unknown-lab", 9000, 9001).run()[0].why
        for who in (*league.REFERENCE_AGENTS, "lqr")
    }
    assert why == dict.fromkeys(league.REFERENCE_AGENTS, "it is made") | {
        "lqr": "it needs information that a laboratory cannot measure"
    }


def test_arms_of_a_scenario_are_moved_by_its_plant(monkeypatch):
    moved = []
    monkeypatch.setattr(league, "PLANTS", {name: ("", name) for name in league.PLANTS})

    def rollout(*_, **named):
        moved.append(named["set_plant"])
        raise ValueError("that is enough")

    monkeypatch.setattr(league, "rollout", rollout)
    for scenario in ("FlexRRR-v0", "FlexRRR-v0@finer"):
        EpisodeBlock("", "zero", scenario, 9000, 9001).run()
    assert moved == ["usual", "finer"]


def test_rows_follow_from_what_is_run_and_from_what_controllers_are_given(monkeypatch):
    one, other = Configuration("FlexOne-v0"), Configuration("FlexOne-v0", {"control_period": 0.02})
    monkeypatch.setattr(league, "_code_hash", lambda *_: "")
    keys = set()
    for scenario in (Scenario(one, one), Scenario(one, other), Scenario(other, one), Scenario(one, one, "finer")):
        monkeypatch.setattr(league, "find_scenario", lambda name: scenario)  # noqa: B023
        keys.add(league._row_key("pd", "FlexOne-v0"))
    assert len(keys) == 4


def test_rows_follow_from_every_file_of_a_run(scenario, tmp_path, monkeypatch):
    monkeypatch.setattr(league, "_code_hash", lambda *_: "")
    keys = [league._row_key(str(tmp_path), scenario)]
    for name in (league.SETTINGS, league.BEST, league.NEWEST):
        for content in (b"one", b"two"):
            (tmp_path / name).write_bytes(content)
            keys.append(league._row_key(str(tmp_path), scenario))
    assert len(set(keys)) == 7


def test_rows_of_another_processor_count(scenario, monkeypatch):
    """Versions of packages change rows, the processor does not."""
    monkeypatch.setattr(league, "_code_hash", lambda *_: "")
    keys = set()
    for processor, version in (("one", "1"), ("two", "1"), ("one", "2")):
        monkeypatch.setattr(league, "computer_info", lambda *_: {"processor": processor, "numpy": version})  # noqa: B023
        keys.add(league._row_key("pd", scenario))
    assert len(keys) == 2


def test_a_clock_keeps_starts_and_actions_apart(monkeypatch):
    """By a clock that goes on by one second in a start and by a thousandth in an action."""
    clock = [0.0]

    def passing(seconds):
        clock[0] += seconds
        return np.zeros((1, 1))

    slow = SimpleNamespace(sensors=(), joints=1, names=(), reset=lambda *_: passing(1.0), act=lambda *_: passing(1e-3))
    monkeypatch.setattr(action_clock, "process_time", lambda: clock[0])
    times = ActionClock()
    timed = TimedMode(slow, times)
    for _ in range(2):
        timed.reset(None, None, 1)
        passing(100.0)
        for _ in range(3):
            timed.act(None, {}, None, None)
    assert (times.start_seconds, times.action_seconds) == pytest.approx((2.0, 6e-3))


def test_times_of_slews_belong_to_the_environment_of_their_table():
    table = SlewTable.load(SHIPPED_TABLE)
    assert optimised_settling_times(Configuration("FlexRRR-v0")) == {
        seed: table.settling_time(seed) for seed in range(9000, 9100)
    }
    assert all(optimised_settling_times(find_scenario(each).environment) == {} for each in USUAL_SCENARIOS[1:])


@pytest.mark.slow
def test_the_multiple_is_that_of_the_optimised_slew():
    """Whose own is 1."""
    at = VALUES.index(TIME_RATIO)
    for agent in ("optimised", "lqr-tracking"):
        rows = EpisodeBlock("", agent, "FlexRRR-v0", 9000, 9003).run()[1]
        multiples = np.array([row.values[at] for row in rows])
        assert (multiples == 1.0 if agent == "optimised" else multiples > 1.2).all()


def test_every_baseline_says_what_it_is_and_a_run_who_trained_it(tmp_path):
    assert {name for name in BASELINES if all(astuple(describe_agent(name))[:2])} == set(BASELINES)
    settings = {"algo": "sac", "environment": {"id": "FlexOne-v0", "base": {"kind": "pd"}, "method": "midpoint_3"}}
    (tmp_path / "settings.json").write_text(json.dumps(settings))
    found = describe_agent(str(tmp_path))
    assert (found.description, found.tuning) == (
        "a policy trained by SAC, with the base controller pd",
        "for a time missing in its curves",
    )
    (tmp_path / "progress.csv").write_text("time/time_elapsed\n90\n")
    assert describe_agent(str(tmp_path)).tuning == "for 1.5 minutes of CPU time"


def test_only_who_is_not_given_the_truth_could_be_built():
    known = {each for each in BASELINES if describe_agent(each).realisable}
    assert known >= {"pd", "pd-shaped", "lqg", "adaptive-lqr"}
    assert not known & {"lqr", "lqr-tracking", "privileged-lqr", "optimised"}


@pytest.mark.parametrize("truth", ["true state", "true parameters", "its episodes"])
def test_one_truth_is_enough_not_to_be_realisable(truth):
    known = describe_agent("pd")
    assert not replace(known, information=("model", truth)).realisable
    assert replace(known, information=("model", "training", "structure of the model")).realisable


def test_in_a_sweep_controllers_are_given_the_range_and_arms_have_the_value():
    environment, given = (each for each in find_scenario("FlexRRR-v0/payload=25")[:2])
    assert environment.disturbances.payload_mass == (25.0, 25.0) and given.disturbances.payload_mass == (0.0, 20.0)
    environment, given = (each for each in find_scenario("FlexRRR-v0/delay=3")[:2])
    assert (environment.max_delay, given.max_delay) == (3, 2)
    assert given.gains == Configuration.find("FlexRRR-v0/random-delay").gains
    environment, given = (each for each in find_scenario("FlexRRR-v0/noise=0")[:2])
    assert environment.disturbances.sensor_noise == (0.0, 0.0) and given.disturbances.sensor_noise == (0.001, 0.001)
    environment, given = (each for each in find_scenario("FlexRRR-v0/period=0.04")[:2])
    assert environment.control_period == given.control_period == 0.04
    environment, given = (each for each in find_scenario("FlexRRR-v0/stiffness=0.5")[:2])
    assert (
        environment.disturbances.link_stiffness_factor == environment.disturbances.joint_stiffness_factor == (0.5, 0.5)
    )
    assert given.disturbances.link_stiffness_factor == (0.7, 1.3)


def test_who_runs_a_sweep_is_made_for_what_it_is_given(tmp_path, monkeypatch):
    """No observer is made for one payload: its range has a width."""
    made = []
    monkeypatch.setattr(AgentSpec, "timed", lambda agent, given: made.append(given) or (agent, None))
    EpisodeBlock("", "zero", "FlexRRR-v0/payload=25", 9000, 9001).run()
    assert [each.disturbances.payload_mass for each in made] == [(0.0, 20.0)]


def test_every_scenario_has_an_environment():
    swept = [f"FlexRRR-v0/{name}={value:g}" for name, sweep in SWEEPS.items() for value in sweep.values]
    for name in [*USUAL_SCENARIOS, *swept]:
        assert find_scenario(name).environment.base is None, "what acts is the agent's"
    assert refusal(find_scenario, "FlexRRR-v0/mass=3").startswith("sweep: 'mass' is not allowed; give one of payload")
    assert "a number after payload=" in refusal(find_scenario, "FlexRRR-v0/payload=much")


def test_a_run_that_has_seen_a_seed_of_the_test_is_refused(tmp_path):
    def run(**changes):
        environment = {"id": "FlexOne-v0", "method": "midpoint_3"}
        settings = {"seed": 3, "envs": 4, "eval_every": 100, "environment": environment} | changes
        (tmp_path / "settings.json").write_text(json.dumps(settings))
        return str(tmp_path)

    first = training_seed(3)
    check_seeds_unseen(run(), range(9000, 9100))
    check_seeds_unseen(run(), [first - 1, first + 4, SELECTION_SEEDS.start - 1, SELECTION_SEEDS.stop])
    check_seeds_unseen(run(eval_every=0), SELECTION_SEEDS)
    for seen in ([first], [first + 3], [*range(9000, 9100), SELECTION_SEEDS.start], [SELECTION_SEEDS.stop - 1]):
        line = refusal(check_seeds_unseen, run(), seen)
        assert f"neither trained nor selected on the seed {seen[-1]}, a test seed" in line
    assert "a run whose settings.json have seed" in refusal(check_seeds_unseen, run(seed=None), range(9000, 9100))
    assert "neither trained nor selected" in refusal(
        run_league, [run()], ["FlexOne-v0"], SELECTION_SEEDS, tmp_path / "league"
    )


def test_a_run_tells_what_it_sees_and_how_long_it_took(tmp_path):
    for sensors, known in (("full", ("training", "true state")), ("lab", ("training",)), ("servo", ("training",)),
                           ({"kind": "full", "noise": 0.01}, ("training", "true state"))):  # fmt: skip
        settings = {"environment": {"id": "FlexOne-v0", "sensors": sensors, "method": "midpoint_3"}}
        (tmp_path / "settings.json").write_text(json.dumps(settings))
        assert describe_agent(str(tmp_path)).information == known
    assert training_seconds(str(tmp_path)) is None and training_seconds("pd") is None
    (tmp_path / "progress.csv").write_text("time/time_elapsed,time/fps\n10,1\n25,1\n")
    (tmp_path / "progress-400.csv").write_text("time/fps,time/time_elapsed\n1,\n1,7\n")
    assert training_seconds(str(tmp_path)) == 32.0
    (tmp_path / "progress.csv").write_text("time/cpu_seconds,time/time_elapsed\n3,10\n9,25\n")
    assert training_seconds(str(tmp_path)) == 16.0, "CPU time where the curves have it"
