"""Learning study: its cases change what they say, its runs are kept, and its page tells medians and worst seeds."""

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.settings import RECIPES, Settings, find_recipe
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.policy_files import POLICIES
from studies.files import read_comment, read_rows
from studies.learning import measure
from studies.learning.measure import (
    ABLATED,
    ABLATIONS,
    AS_TRAINED,
    CONTROLLERS,
    FINER,
    LAW,
    LONGER,
    POINTS,
    SEEDS,
    TASKS,
    UNKNOWN,
    VENUES,
    LearningCase,
    LearningRow,
    Point,
    adds_to_pd,
    cases,
    environment,
    pictures,
    places,
    points,
    runs,
    trained,
)
from studies.learning.page import page

from oracles.files import ROOT, command

ROW = LearningRow(
    "recipe", ABLATED, 0.0, AS_TRAINED, 1e6, 80.0, 12500.0, 0.4, 0.97, 4.2, 4.1, 4.4, 5e-4, 3e-3, 370.0, 0.1, 0.0, 0.05
)
SHORT = Settings(
    environment={"id": "FlexOne-v0", "base": "pd", "action_repeat": 5, "horizon": 1.0},
    steps=16, envs=2, hyperparameters={"n_steps": 8, "net_arch": [8]},
)  # fmt: skip


def test_every_recipe_is_judged():
    assert sorted(SEEDS) == RECIPES and VENUES.keys() <= SEEDS.keys()
    assert [case.name for case in cases() if case.kind == "recipe"] == list(SEEDS)


def differences(first, second):
    """Names of settings, and of entries of their mappings, that differ."""
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
    result = places(Configuration("FlexPlanar-v0"))
    finer = result[FINER]
    assert (finer.elements, finer.modes, finer.stiffening, finer.step) == (3, None, True, 2.5e-3 / 4)
    assert result[AS_TRAINED].stiffening is False and result[LONGER].horizon == 30.0


def test_a_run_is_trained_once_and_judged_in_three_places(tmp_path, monkeypatch):
    monkeypatch.setattr(measure, "TEST", range(9000, 9002))
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


def test_the_page_has_the_middle_and_the_worst_of_the_seeds_of_an_ablation():
    seeds = [
        replace(ROW, kind="ablation", name="discount", seed=float(i), settled=share, time=time, error=error)
        for i, (share, time, error) in enumerate([(0.5, 5.0, 1e-3), (0.9, 4.0, 9e-3), (0.7, math.inf, 2e-3)])
    ]
    text = page([ROW, *seeds], "a machine")
    assert (
        "| the short horizon | a discount of 0.99 an action | 1,000,000 | 80 | 70 (50) | 5 (-) | 0.5 (0.5) | 2 (9) |"
        in text
    )
    assert (
        f"| {ABLATED} | 0 | 1,000,000 | 80 | 12,500 | 40% | 97% | 4.2 (4.1 to 4.4) "
        "| 0.5 | 3 | 370 | 0.100 | 0.050 | 0% |" in text
    )


def test_the_published_page_is_that_of_the_published_rows():
    file = ROOT / "docs" / "learning.csv"
    rows = read_rows(file, LearningRow)
    for kind, counts in (("recipe", SEEDS), ("ablation", dict.fromkeys(ABLATIONS, 3))):
        assert {row.name for row in rows if row.kind == kind} == counts.keys()
        for name, count in counts.items():
            result = [row for row in rows if (row.kind, row.name, row.where) == (kind, name, AS_TRAINED)]
            assert sorted(row.seed for row in result) == list(range(count))
            steps = next(case for case in cases() if (case.kind, case.name) == (kind, name)).settings.steps
            assert all(row.steps == steps for row in result), "the rows are of another recipe"
    assert (ROOT / "docs" / "learning.md").read_text(encoding="utf-8") == page(rows, read_comment(file))
    names = {row.name for row in rows if row.kind == "controller"}
    assert names == {f"{name}, {id}" for id, names in CONTROLLERS.items() for name in names}
    learned = {venue: [name] if name in POLICIES else [] for venue, (name, _) in TASKS.items()}
    expected = {f"{name}, {venue}" for venue, (_, law) in TASKS.items() for name in ("pd", law, *learned[venue])}
    assert {row.name for row in rows if row.kind == "task"} == expected
    curves = read_rows(ROOT / "docs" / "learning_curves.csv", Point)
    assert {point.name for point in curves} <= SEEDS.keys()
    for id in {environment(point.name) for point in curves if adds_to_pd(point.name)}:
        assert (ROOT / "docs" / f"learning_{id}.png").is_file()


def test_the_page_says_what_a_policy_leaves_of_the_figure_of_a_pd():
    """Of settling times where arms settle, of RMS errors where tips follow, in the middle of seeds."""
    slew, track = "FlexRRR-Gravity-v0", "FlexRRR-Track-v0"
    rows = [replace(ROW, kind="task", name=f"{who}, {slew}", time=time) for who, time in (("pd", 4.0), (LAW, 2.0))]
    rows += [replace(ROW, kind="task", name=f"{who}, {track}", rms=rms) for who, rms in (("pd", 0.2), (LAW, 1e-4))]
    rows += [replace(ROW, name="gravity_ppo_on_pd", seed=float(seed), time=1.0 + seed) for seed in range(3)]
    rows += [replace(ROW, name="track_ppo_on_pd", rms=0.05), replace(ROW, kind="task", name=f"pd, {UNKNOWN}")]
    text = page(rows, "a machine")
    assert f"| `{slew}` | 97%, 4 s | `gravity_ppo_on_pd`: 97%, 2 s | 0.50 | `{LAW}`: 97%, 2 s |" in text
    assert f"| `{track}` | 200 mm | `track_ppo_on_pd`: 50 mm | 0.25 | `{LAW}`: 0.1 mm |" in text
    assert f"| `{UNKNOWN}` |" not in text, "its other rows are missing"


def test_the_curve_of_a_run_is_that_of_its_training_rewards(tmp_path):
    steps = np.arange(100, 10_001, 100)
    lines = ["time/total_timesteps,rollout/ep_rew_mean", *(f"{step},{2.0 * step}" for step in steps)]
    (tmp_path / "progress.csv").write_text("\n".join(lines) + "\n")
    result = list(points(ABLATED, 1, tmp_path))
    assert (len(result), result[0].steps, result[-1].steps) == (POINTS, 100.0, 10_000.0)
    assert all(point.reward == pytest.approx(2.0 * point.steps) and point.seed == 1 for point in result)
    other = [replace(point, name="lab_ppo_shaping") for point in result]
    assert pictures([*result, *other], tmp_path) == [tmp_path / "learning_FlexRRR-v0.png"]
    assert (tmp_path / "learning_FlexRRR-v0.png").stat().st_size > 1000


def test_an_unknown_case_is_refused_in_one_line(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["learning", "recipe/nothing"])
    assert command("learning").main() == 2
    said = capsys.readouterr().err
    assert said.startswith("case: recipe/nothing is not allowed; give controllers, tasks, recipe/ppo_on_pd")
