"""Search: trials are proposed, pruned, resumed after a kill, and the best is a recipe that gives its bits again."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace

import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents.search import BEST_FILE, search
from flexman_agents.settings import find_recipe
from flexman_agents.training import train
from flexman_gym.__main__ import main
from flexman_gym.common.run_folder import NEWEST

from oracles.assertions import refusal
from oracles.runs import RUNS, bits

pytestmark = pytest.mark.slow

RECIPE = replace(RUNS["ppo"], eval_every=48, schedules={}, environment={
    "id": "FlexOne-v0", "base": "pd", "action_repeat": 5, "horizon": 0.3})  # fmt: skip
OVER = {
    "hyperparameters.gamma": {"low": 0.5, "high": 0.99},
    "hyperparameters.learning_rate": {"low": 1e-5, "high": 1.0, "log": True},
    "hyperparameters.n_epochs": {"low": 1, "high": 3, "whole": True},
    "hyperparameters.batch_size": {"choices": [12, 24]},
}


def trials(folder):
    """What the journal of a search holds of each trial."""
    import optuna

    backend = optuna.storages.journal.JournalFileBackend(str(folder / "study.log"))
    study = optuna.load_study(study_name="flexman", storage=optuna.storages.JournalStorage(backend))
    return [(each.state.name, each.params, each.value) for each in study.trials]


def test_the_command_reads_what_settings_may_be_as_a_file_has_it(tmp_path, capsys):
    pytest.importorskip("optuna", reason="Optuna is not installed")
    (tmp_path / "recipe.json").write_text(json.dumps(RECIPE.plain()))
    (tmp_path / "over.yaml").write_text("hyperparameters:\n  gamma: {low: 0.5, high: 0.9}\nenvs: {choices: [2, 3]}\n")
    own = ["--folder", str(tmp_path / "search"), "--trials", "1"]
    assert main(["search", str(tmp_path / "recipe.json"), "--over", str(tmp_path / "over.yaml"), *own]) == 0
    ((_, found, _),) = trials(tmp_path / "search")
    assert 0.5 <= found["hyperparameters.gamma"] <= 0.9 and found["envs"] in (2, 3)
    assert "best.yaml" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("over", "line"),
    [
        ({"gamma": {"low": 0.5, "high": 0.9}}, "over.gamma: 'gamma' is not allowed; give one of base_in_use"),
        ({"steps": {"low": 1, "high": 9}}, "over.steps: 'steps' is not allowed"),
        ({"envs": {"low": 1.0}}, "over.envs: {'low': 1.0} is not allowed; give a mapping with low and high"),
        ({"envs": {"low": 9, "high": 1}}, "over.envs: "),
        ({"hyperparameters.gamma": {"low": 0.5, "high": 2.0}}, "hyperparameters.gamma: 2.0 is not allowed"),
    ],
)
def test_what_cannot_be_searched_is_refused_in_one_line(over, line, tmp_path):
    pytest.importorskip("optuna")
    assert refusal(search, RECIPE, over, tmp_path / "search", 2).startswith(line)
    assert not (tmp_path / "search").exists()


@pytest.mark.parametrize("drawn", [0, 1, 2])
def test_search_broken_off_between_two_draws_of_a_trial_proposes_the_same_values(drawn, tmp_path, monkeypatch):
    optuna = pytest.importorskip("optuna", reason="Optuna is not installed")
    search(RECIPE, OVER, tmp_path / "whole", 6)
    draws = [0]

    def broken(original):
        def suggest(trial, *arguments, **keywords):
            if trial.number == 5:
                draws[0] += 1
                if draws[0] > drawn:
                    raise KeyboardInterrupt
            return original(trial, *arguments, **keywords)

        return suggest

    with monkeypatch.context() as patch:
        for name in ("suggest_float", "suggest_int", "suggest_categorical"):
            patch.setattr(optuna.trial.Trial, name, broken(getattr(optuna.trial.Trial, name)))
        with pytest.raises(KeyboardInterrupt):
            search(RECIPE, OVER, tmp_path / "broken", 6)
    search(RECIPE, OVER, tmp_path / "broken", 6)
    assert trials(tmp_path / "broken") == trials(tmp_path / "whole")


def test_a_search_that_is_killed_goes_on_and_its_best_trial_is_a_recipe_of_the_same_bits(tmp_path):
    """Twelve trials, killed after four of them."""
    pytest.importorskip("optuna", reason="Optuna is not installed")
    (tmp_path / "study.py").write_text(
        "from pathlib import Path; from flexman_agents.search import search\n"
        "from flexman_agents.settings import Settings\n"
        f"search(Settings.from_dict({RECIPE.plain()!r}), {OVER!r}, Path('killed'), 12)"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen([sys.executable, "study.py"], cwd=tmp_path, env=environment)
    while not (tmp_path / "killed" / "trial-4" / NEWEST).exists():
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert len(trials(tmp_path / "killed")) < 12
    path = search(RECIPE, OVER, tmp_path / "killed", 12)
    search(RECIPE, OVER, tmp_path / "whole", 12)
    assert trials(tmp_path / "killed") == trials(tmp_path / "whole")
    states = [state for state, *_ in trials(tmp_path / "whole")]
    assert len(states) == 12 and set(states) == {"COMPLETE", "PRUNED"}
    best = max((value, number) for number, (state, _, value) in enumerate(trials(path.parent)) if state == "COMPLETE")
    assert path.name == BEST_FILE and f"# Found by flexman search: trial {best[1]} of 12" in path.read_text()
    train(find_recipe(str(path)), tmp_path / "again", progress=False)
    assert bits(tmp_path / "again") == bits(tmp_path / "killed" / f"trial-{best[1]}")
