"""Tests of the learning study: cases, stored runs, published rows."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.settings import RECIPES, Settings, find_recipe
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.policy_files import POLICIES
from studies.__main__ import main
from studies.files import read_rows
from studies.generalist.measure import POLICY as GENERALIST
from studies.learning import measure
from studies.learning import page as learning_page
from studies.learning.algorithms import RECIPES as COMPARED
from studies.learning.measure import (
    ABLATED,
    ABLATIONS,
    AS_TRAINED,
    CONTROLLERS,
    EVALUATED_IN,
    FINER,
    LONGER,
    PICTURE,
    POINTS,
    SEEDS,
    TASKS,
    LearningCase,
    LearningRow,
    Point,
    cases,
    points,
    runs,
    trained,
    variants,
)
from studies.safety.learning import RECIPE as SAFETY_RECIPE

from oracles.files import ROOT

SHORT = Settings(
    environment={"id": "FlexOne-v0", "base": "pd", "action_repeat": 5, "horizon": 1.0},
    steps=16, envs=2, hyperparameters={"n_steps": 8, "net_arch": [8]},
)  # fmt: skip


def test_every_recipe_is_judged():
    assert (
        sorted({*SEEDS, SAFETY_RECIPE, GENERALIST, *COMPARED.values()}) == RECIPES
        and EVALUATED_IN.keys() <= SEEDS.keys()
    )
    assert [case.name for case in cases() if case.kind == "recipe"] == list(SEEDS)


def differences(first, second):
    """Return the names of settings, and of entries of their mappings, that differ."""
    result = set()
    for name, value in first.plain().items():
        other = second.plain()[name]
        if isinstance(value, dict):
            result |= {key for key in value.keys() | other.keys() if value.get(key) != other.get(key)}
        elif value != other:
            result.add(name)
    return result


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("hold", {"action_repeat", "gamma", "gae_lambda", "n_steps", "steps"}),
        ("rate", {"learning_rate"}),
        ("reward", {"task"}), ("discount", {"gamma"}),
    ],
)  # fmt: skip
def test_an_ablation_takes_away_one_means_and_nothing_else(name, changed):
    whole = find_recipe(ABLATED)
    assert differences(ABLATIONS[name].settings(whole), whole) == changed


def test_every_ablation_is_among_the_cases():
    assert [case.name for case in cases() if case.kind == "ablation"] == list(ABLATIONS)


def test_a_finer_model_and_longer_episodes_are_what_they_say():
    result = variants(Configuration("FlexPlanar-v0"))
    finer = result[FINER]
    assert (finer.elements, finer.modes, finer.stiffening, finer.step) == (3, None, True, 2.5e-3 / 4)
    assert result[AS_TRAINED].stiffening is False and result[LONGER].horizon == 30.0


@pytest.mark.slow
def test_a_run_is_trained_once_and_judged_in_three_places(tmp_path, monkeypatch):
    monkeypatch.setattr(measure, "TEST_SEEDS", range(9000, 9002))
    case = LearningCase("recipe", "short", SHORT, 2)
    result = list(runs(case, tmp_path))
    assert [(row.seed, row.where) for row in result] == [
        (seed, where) for seed in (0, 1) for where in (AS_TRAINED, FINER, LONGER)
    ]
    assert all(row.steps == 16 and row.cpu > 0.0 and 0.0 < row.share < 1.0 for row in result)
    assert result[0].rate == pytest.approx(16 / result[0].cpu)
    monkeypatch.setattr(measure, "train", None)
    assert list(runs(case, tmp_path)) == result
    assert [row.where for row in runs(replace(case, kind="ablation", seeds=0), tmp_path)] == []
    assert trained((SHORT, tmp_path / "recipe" / "short" / "seed-0"))["steps"] == 16


@pytest.mark.evidence
@pytest.mark.slow
def test_published_rows_are_those_of_the_recipes_controllers_and_tasks():
    rows = read_rows(ROOT / "docs" / "evidence" / "learning.csv", LearningRow)
    for kind, counts in (("recipe", SEEDS), ("ablation", dict.fromkeys(ABLATIONS, 3))):
        assert {row.name for row in rows if row.kind == kind} == counts.keys()
        for name, count in counts.items():
            result = [row for row in rows if (row.kind, row.name, row.where) == (kind, name, AS_TRAINED)]
            assert sorted(row.seed for row in result) == list(range(count))
            steps = next(case for case in cases() if (case.kind, case.name) == (kind, name)).settings.steps
            assert all(row.steps == steps for row in result), "the rows are of another recipe"
    names = {row.name for row in rows if row.kind == "controller"}
    assert names == {f"{name}, {id}" for id, names in CONTROLLERS.items() for name in names}
    learned = {scenario: [name] if name in POLICIES else [] for scenario, (name, _) in TASKS.items()}
    expected = {
        f"{name}, {scenario}" for scenario, (_, law) in TASKS.items() for name in ("pd", law, *learned[scenario])
    }
    assert {row.name for row in rows if row.kind == "task"} == expected
    curves = read_rows(ROOT / "docs" / "evidence" / "learning_curves.csv", Point)
    assert {point.name for point in curves} <= SEEDS.keys() and (ROOT / "docs" / "evidence" / PICTURE).is_file()


def test_spreads_are_medians_and_ranges_over_the_seeds():
    row = next(row for row in read_rows(ROOT / "docs" / "evidence" / "learning.csv", LearningRow) if row.cpu)
    seeds = [replace(row, time=time, vibration=size) for time, size in ((3.2, 9e-5), (np.inf, 1e-9), (3.0, 1.2e-3))]
    assert learning_page._spread(seeds, learning_page._time) == "3.20 (3.00 to -)"
    assert learning_page._spread(seeds, learning_page._vibration) == "0.09 (below 0.01 to 1.2)"
    assert learning_page._spread(seeds[:1] * 3, learning_page._time) == "3.20"


@pytest.mark.evidence
def test_every_recipe_and_policy_is_on_the_page():
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in text for name in (*SEEDS, *POLICIES))


def test_the_curve_of_a_run_is_that_of_its_training_rewards(tmp_path):
    steps = np.arange(100, 10_001, 100)
    lines = ["time/total_timesteps,rollout/ep_rew_mean", *(f"{step},{2.0 * step}" for step in steps)]
    (tmp_path / "progress.csv").write_text("\n".join(lines) + "\n")
    result = list(points(ABLATED, 1, tmp_path))
    assert (len(result), result[0].steps, result[-1].steps) == (POINTS, 100.0, 10_000.0)
    assert all(point.reward == pytest.approx(2.0 * point.steps) and point.seed == 1 for point in result)


def test_an_unknown_case_is_refused_in_one_line(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["learning", "--only", "recipe/nothing"])
    assert stop.value.code == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "argument --only: invalid choice: 'recipe/nothing' (choose from 'recipe/" in said
    assert "'recipe/ppo_on_pd'" in said
