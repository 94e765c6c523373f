"""Tests of the comparison of algorithms: CPU time across interruptions, rows made once, page."""

import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.callbacks import TrainingReport
from flexman_agents.settings import find_recipe
from flexman_gym.common.run_folder import NEWEST, read_npz
from flexman_gym.metrics.statistics import median_interval
from studies.files import read_rows
from studies.learning import algorithms, algorithms_page
from studies.learning.algorithms import (
    BUDGETS,
    RECIPES,
    REFERENCES,
    STEPS,
    AlgorithmRow,
    Cell,
    Clock,
    Spent,
    run,
    run_settings,
)
from studies.runners.algorithms import RUNNER

from oracles.runs import RUNS


@pytest.fixture
def seconds(monkeypatch):
    """CPU time of the process, s, which a test sets."""
    now = [100.0]
    monkeypatch.setattr(time, "process_time", lambda: now[0])
    return now


def report(steps, saved):
    return TrainingReport(steps, {}, lambda: saved.append(steps))


def test_the_cpu_time_goes_on_where_the_saved_state_is(tmp_path, seconds):
    """Saved after 130 s, killed at 190 s, and stopped by the budget of 200 s: 70 s later."""
    saved = []
    clock = Clock(tmp_path, 200.0, 1000)
    for steps, now in ((0, 100.0), (10, 219.0), (20, 230.0), (30, 290.0)):
        seconds[0] = now
        assert not clock(report(steps, saved))
    assert saved == [20] and clock.spent == Spent(20, 130.0)
    seconds[0] = 5.0
    clock = Clock(tmp_path, 200.0, 1000)
    assert not clock(report(20, saved))
    seconds[0] = 74.9
    assert not clock(report(30, saved))
    seconds[0] = 75.0
    assert clock(report(40, saved)) and clock.spent == Spent(40, 200.0) and saved == [20]
    assert read_rows(tmp_path / "cpu.csv", Spent) == [Spent(20, 130.0), Spent(40, 200.0)]


def test_steps_that_were_lost_do_not_count(tmp_path, seconds):
    """Killed between the row of 40 steps and the state of 40 steps: the state is that of 20 steps."""
    saved = []
    clock = Clock(tmp_path, 1e3, 1000)
    for steps, now in ((0, 100.0), (20, 230.0), (40, 360.0)):
        seconds[0] = now
        clock(report(steps, saved))
    clock = Clock(tmp_path, 1e3, 1000)
    assert not clock(report(20, saved))
    seconds[0] += 125.0
    clock(report(30, saved))
    assert clock.spent == Spent(30, 255.0)


def test_a_checkpoint_costs_no_cpu_time_and_the_last_step_ends_the_clock(tmp_path, seconds):
    clock = Clock(tmp_path, 1e3, 50)
    clock(report(0, []))
    seconds[0] += 120.0
    clock(TrainingReport(10, {}, lambda: seconds.__setitem__(0, seconds[0] + 7.0)))
    seconds[0] += 60.0
    assert clock(report(50, [])) and clock.spent == Spent(50, 180.0)


def test_the_cpu_time_before_ctrl_c_is_kept(tmp_path, seconds):
    """The run is saved one rollout after the latest call; a state of fewer steps does not count it."""
    clock = Clock(tmp_path, 1e3, 1000)
    clock.keep()
    assert not (tmp_path / "cpu.csv").exists()
    for steps, now in ((0, 100.0), (20, 130.0)):
        seconds[0] = now
        clock(report(steps, []))
    clock.keep()
    assert read_rows(tmp_path / "cpu.csv", Spent) == [Spent(20, 30.0)]
    for steps, cpu in ((30, 30.0), (10, 0.0)):
        later = Clock(tmp_path, 1e3, 1000)
        later(report(steps, []))
        later.keep()
        assert later.spent == Spent(steps, cpu)


def row(algorithm, seed=None, minutes=None, times=(2.0, 3.0, 4.0), **own):
    """Return a row with these settling times."""
    values = {"cpu": None, "steps": None, "settled": 1.0, "time": float(np.median(times)), "vibration": 1e-4} | own
    return AlgorithmRow(algorithm, seed, minutes, **values, times=" ".join(map(str, times)))


@pytest.mark.slow
def test_a_run_goes_on_from_row_to_row_and_makes_none_twice(tmp_path, monkeypatch):
    """With a clock that counts the calls of the hook: 4 of 7 rollouts, then the rest."""
    ticks = iter(range(10**6))
    monkeypatch.setattr(time, "process_time", lambda: float(next(ticks)))
    monkeypatch.setattr(algorithms, "evaluated", lambda agent: row(agent))
    settings = replace(RUNS["ppo"], eval_every=0)
    first = run(Cell(settings, tmp_path / "run", (0.05,)))
    assert [(each.algorithm, each.seed, each.minutes) for each in first] == [("ppo", 2.0, 0.05)]
    assert first[0].steps == read_npz(tmp_path / "run" / NEWEST)["training"]["counts"]["num_timesteps"] < 160
    both = run(Cell(settings, tmp_path / "run", (0.05, 40.0)))
    assert both[0] == first[0] and both[1].steps == 168 and both[1].cpu > both[0].cpu >= 3.0
    monkeypatch.setattr(algorithms, "train_or_resume", None)
    assert run(Cell(settings, tmp_path / "run", (0.05, 40.0))) == both


def test_known_rows_are_not_made_again(tmp_path, monkeypatch):
    monkeypatch.setattr(algorithms, "evaluated", lambda agent: row(agent))
    made = []

    def add(cell):
        made.append((cell.settings.algo, cell.settings.seed, *cell.budgets))
        return [row(cell.settings.algo, cell.settings.seed, minutes) for minutes in cell.budgets]

    monkeypatch.setattr(algorithms, "run", add)
    known = {each.key: each for each in (row("sac", 0.0, 2.0), row("pd", settled=0.5))}
    cells = [Cell(run_settings(name, seed), tmp_path, BUDGETS[:2]) for seed in (0, 1) for name in ("sac", "tqc")]
    result = list(algorithms.measure(known, cells))
    assert made == [("sac", 0, 10.0), ("tqc", 0, 2.0, 10.0), ("sac", 1, 2.0, 10.0), ("tqc", 1, 2.0, 10.0)]
    assert [each.key for each in result[:6]] == [
        *((name, None, None) for name in REFERENCES), ("sac", 0.0, 2.0), ("sac", 0, 10.0)
    ]  # fmt: skip
    assert next(each for each in result if each.algorithm == "pd").settled == 0.5 and len(result) == 4 + 8


@pytest.mark.parametrize("name", RECIPES)
def test_runs_differ_from_their_recipes_in_length_and_evaluations_only(name):
    settings, recipe = run_settings(name, 3), find_recipe(RECIPES[name])
    assert (
        settings.algo == name and replace(settings, steps=recipe.steps, eval_every=recipe.eval_every, seed=0) == recipe
    )


def test_recipes_of_the_comparison_have_the_same_environment():
    assert len({str(find_recipe(name).environment.to_plain()) for name in RECIPES.values()}) == 1


@pytest.mark.slow
def test_the_row_of_an_agent_has_the_metrics_of_its_episodes(monkeypatch):
    monkeypatch.setattr(algorithms, "EPISODES", range(130_000, 130_003))
    result = algorithms.evaluated("lqr-tracking")
    assert len(result.settling_times) == 3 and result.settled == np.isfinite(result.settling_times).mean()
    assert result.time == pytest.approx(np.sort(result.settling_times)[1], rel=5e-3)


def test_results_are_those_of_the_hierarchical_bootstrap():
    rows = [row("tqc", seed, 2.0, times) for seed, times in enumerate(([2.0, 3.0, 4.0], [2.5, 3.5, np.inf]))]
    found = algorithms_page.result(rows, "tqc", 2.0)
    assert (found.time, found.low, found.high) == median_interval(np.array([[2.0, 3.0, 4.0], [2.5, 3.5, np.inf]]))
    assert found.seeds == 2 and algorithms_page.result(rows, "tqc", 10.0) is None


def test_the_page_names_the_fastest_and_whether_the_intervals_overlap():
    rows = [row(name, 0.0, minutes, [time] * 3) for minutes in BUDGETS
            for name, time in (("sac", 2.5), ("tqc", 2.6), ("crossq", 2.7), ("ppo", np.inf))]  # fmt: skip
    sentence = algorithms_page.comparison(rows)
    assert sentence.startswith(
        "With 1 seed each, after 2 CPU minutes SAC (100 %, 2.50 s) is ahead of TQC (100 %, 2.60 s);"
    )
    assert "overlap" not in sentence
    assert ", intervals overlap;" in algorithms_page.comparison([*rows, row("tqc", 1.0, 2.0, [2.4] * 3)])
    text = algorithms_page.page([*rows, row("planned")], {"algorithms.csv": "a computer"})
    assert "| PPO (1) | 100 % (44 to 100) | 100 % (44 to 100) | 100 % (44 to 100) |" in text
    assert "| `planned` |  |  |  | 100 % (44 to 100), 3.00 s (2.00 to 4.00) |" in text
    assert "or after 40 minutes. Schedules" in " ".join(text.split())
    longest = [row("sac", 1.0, 40.0, steps=0.5 * STEPS["sac"]), row("ppo", 1.0, 40.0, steps=0.75 * STEPS["ppo"])]
    text = algorithms_page.page([*rows, *longest], {"algorithms.csv": "a computer"})
    assert "after 40 minutes (here 50 to 75 % of its schedules). Schedules" in " ".join(text.split())
    assert algorithms_page.comparison(rows[:3]) == "Not all algorithms have rows yet."


def test_agents_without_training_are_compared_with_the_fastest_policy_of_all_times():
    agents = [row("pd", times=[np.inf] * 3), row("lqr-tracking"), row("planned", times=[2.0] * 3)]
    policies = [row("sac", 0.0, 2.0, [2.4] * 3), row("tqc", 0.0, 10.0, [2.5] * 3)]
    assert algorithms_page.references([*agents, *policies]) == (
        "The fastest policy, of SAC after 2 minutes (2.40 s), is faster than `pd` (half do not settle) "
        "and `lqr-tracking` (3.00 s); training does not pay where `planned` (2.00 s) can be used."
    )
    assert algorithms_page.references(agents) == "There is no policy to compare yet."


def test_the_runner_names_its_table_and_page():
    assert [table.file for table in RUNNER.tables] == ["algorithms"] and [*RUNNER.pages] == ["algorithms.md"]
