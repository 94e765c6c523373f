"""Search without Optuna: how often trials are compared, what a trial is worth, and when it is pruned."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexman_agents import search as module
from flexman_agents.callbacks import TrainingReport
from flexman_agents.search import search
from flexman_agents.settings import find_recipe

from oracles.assertions import refusal
from oracles.runs import RUNS

RECIPE = RUNS["ppo"]
OVER = {"hyperparameters.gamma": {"low": 0.5, "high": 0.9}}


class Study:
    """A study whose trials are pruned where `prunes` says so; keeps what was told of them."""

    def __init__(self, prunes=False):
        self.prunes, self.trials, self.told, self.values = prunes, [], [], {}
        self._cached_frozen_trial = SimpleNamespace(intermediate_values={})

    def get_trials(self, deepcopy=True):
        return self.trials

    def ask(self):
        number = len(self.trials)
        state = SimpleNamespace(is_finished=lambda: number in [each[0] for each in self.told], name="COMPLETE")
        self.trials.append(SimpleNamespace(number=number, state=state, intermediate_values=self.values))
        return self.trials[-1]

    def tell(self, number, value=None, state="COMPLETE"):
        self.told.append((number, value, state))

    def report(self, value, step):
        self.values[step] = value

    def should_prune(self):
        return self.prunes


@pytest.fixture
def optuna(monkeypatch):
    """Names of Optuna that a search uses."""
    states = SimpleNamespace(PRUNED="PRUNED", FAIL="FAIL")
    samplers = SimpleNamespace(TPESampler=lambda seed: seed)
    monkeypatch.setattr(module, "_optuna", lambda: SimpleNamespace(
        trial=SimpleNamespace(TrialState=states), samplers=samplers
    ))  # fmt: skip


def searched(monkeypatch, folder, recipe=RECIPE, over=OVER, trials=1, workers=1, seed=0, **replaced):
    """Return the cells of a search whose trials are all worth 1, with functions of the search replaced."""
    study, cells = Study(), []

    def spread(run, given, workers, prepare):
        cells.extend(given)
        for *_, number in given:
            study.tell(number, 1.0)
        return iter([None] * len(given))

    given = {"_study": lambda folder: study, "_keep_best": lambda study, recipe, folder: folder}
    for name, function in {**given, "parallel_map_unordered": spread, **replaced}.items():
        monkeypatch.setattr(module, name, function)
    search(recipe, over, folder, trials, workers=workers, seed=seed)
    return cells


def ran(monkeypatch, tmp_path, study, rewards):
    """What a study was told of a trial that earns these rewards, one after the other, and how many were waited for."""
    steps, seen = RECIPE.steps // len(rewards), []

    def trained(cell):
        for i, reward in enumerate(rewards, 1):
            if np.isnan(reward):
                raise ValueError("it diverges")
            seen.append(reward)
            last = i == len(rewards)
            if cell[2]["hook"](TrainingReport(RECIPE.steps if last else i * steps, {"reward": reward}, lambda: None)):
                break

    study.ask()
    monkeypatch.setattr(module, "_study", lambda folder: study)
    monkeypatch.setattr(module, "_trial", lambda study, number: study)
    monkeypatch.setattr(module, "train_or_resume", trained)
    monkeypatch.setattr(module, "_proposed", lambda study, number, over, seed: {})
    monkeypatch.setattr(module, "_keep_best", lambda study, recipe, folder: folder)
    monkeypatch.setattr(module, "parallel_map_unordered", lambda run, cells, *_, **__: [run(each) for each in cells])
    search(RECIPE, OVER, tmp_path, 1)
    return study.told, len(seen)


def test_a_trial_is_worth_its_best_policy(optuna, monkeypatch, tmp_path):
    """Which is the one that a run keeps."""
    assert ran(monkeypatch, tmp_path, Study(), [1.0, 5.0, 3.0]) == ([(0, 5.0, "COMPLETE")], 3)


def test_a_trial_is_pruned_on_its_way_and_not_at_its_end(optuna, monkeypatch, tmp_path):
    assert ran(monkeypatch, tmp_path, Study(prunes=True), [1.0, 5.0, 3.0]) == ([(0, None, "PRUNED")], 1)
    assert ran(monkeypatch, tmp_path, Study(prunes=True), [2.0]) == ([(0, 2.0, "COMPLETE")], 1)


def test_a_trial_that_diverges_has_failed(optuna, monkeypatch, tmp_path, capsys):
    assert ran(monkeypatch, tmp_path, Study(), [1.0, np.nan]) == ([(0, None, "FAIL")], 1)
    assert capsys.readouterr().err == "trial 0: it diverges\n"


def test_a_trial_that_was_killed_when_it_was_pruned_does_not_go_on(optuna, monkeypatch, tmp_path):
    study = Study(prunes=True)
    study._cached_frozen_trial.intermediate_values[16] = 1.0
    assert ran(monkeypatch, tmp_path, study, [1.0, 2.0]) == ([(0, None, "PRUNED")], 0)


def test_an_evaluation_is_reported_once(optuna, monkeypatch, tmp_path):
    """Rollouts that begin after it show it again."""
    study = Study()
    ran(monkeypatch, tmp_path, study, [1.0, 1.0, 2.0, 2.0])
    assert [*study.values.values()] == [1.0, 2.0]


@pytest.mark.parametrize(("asked", "every"), [(0, RECIPE.steps // 10), (48, 48)])
def test_trials_are_compared_ten_times_where_the_recipe_does_not_say(asked, every, optuna, monkeypatch, tmp_path):
    proposed = lambda study, number, over, seed: {"hyperparameters.gamma": 0.7}  # noqa: E731
    ((settings, _, number),) = searched(monkeypatch, tmp_path, replace(RECIPE, eval_every=asked), _proposed=proposed)
    assert (settings.eval_every, settings.hyperparameters["gamma"], number) == (every, 0.7, 0)


def test_every_value_is_drawn_by_a_seed_of_its_own(optuna, monkeypatch, tmp_path):
    """However often it is asked for, though several trials are at work at once; else the first ones would be alike."""
    seeds = []

    class Trial:
        def __init__(self, study, number):
            self.study, self.number = study, number

        def suggest_float(self, path, low, high, log):
            seeds.append((self.number, path, self.study.sampler))
            return low

    over = OVER | {"hyperparameters.learning_rate": {"low": 1e-5, "high": 1.0, "log": True}}
    cells = searched(monkeypatch, tmp_path, over=over, trials=3, workers=2, seed=7, _trial=Trial)
    drawn = {(number, path): seed for number, path, seed in seeds}
    assert len(cells) == 3 and len(set(drawn.values())) == len(drawn) == 6
    assert {*seeds} == {(*place, seed) for place, seed in drawn.items()}  # a second call has the same seed


def test_the_best_trial_becomes_a_recipe(optuna, monkeypatch, tmp_path):
    study = Study()
    study.ask(), study.ask()
    changes = {"hyperparameters.gamma": 0.7, "environment.action_repeat": 2,
               "schedules.log_std.start": -1.0, "schedules.log_std.end": -2.0}  # fmt: skip
    study.best_trial = SimpleNamespace(number=1, params=dict(changes), value=5.0)
    monkeypatch.setattr(module, "computer_text", lambda packages: "a machine")
    study.tell(0, 1.0), study.tell(1, 5.0)
    monkeypatch.setattr(module, "_study", lambda folder: study)
    path = search(RECIPE, OVER, tmp_path, 2)
    found = find_recipe(str(path))
    assert found.hyperparameters["gamma"] == 0.7 and found.environment.action_repeat == 2
    assert found.schedule("log_std").at(1.0) == -2.0 and found.steps == RECIPE.steps
    assert path.read_text().startswith("# Found by flexman search: trial 1 of 2 (2 complete).\n")


def test_whole_numbers_choices_and_logarithms_are_asked_for(optuna, monkeypatch, tmp_path):
    asked = []
    names = ("suggest_int", "suggest_float", "suggest_categorical")
    values = dict(zip(names, (3, 0.5, 4), strict=True))
    trial = SimpleNamespace(
        **{name: lambda *given, name=name, **more: asked.append((name, *given, *more.values())) or values[name]
           for name in names}
    )  # fmt: skip
    over = {
        "hyperparameters.n_epochs": {"low": 1, "high": 3, "whole": True},
        "hyperparameters.gamma": {"low": 0.1, "high": 0.9, "log": True},
        "envs": {"choices": [2, 4]},
    }
    ((settings, _, _),) = searched(monkeypatch, tmp_path, over=over, _trial=lambda study, number: trial)
    assert set(map(str, asked)) == {
        "('suggest_int', 'hyperparameters.n_epochs', 1, 3, False)",
        "('suggest_float', 'hyperparameters.gamma', 0.1, 0.9, True)",
        "('suggest_categorical', 'envs', [2, 4])",
    }
    chosen = settings.hyperparameters
    assert (chosen["n_epochs"], chosen["gamma"], settings.envs) == (3, 0.5, 4)


@pytest.mark.parametrize("ends", [(0.0, 1.0, True), (-1.0, 1.0, True), (0.5, 0.5, False)])
def test_ends_between_which_nothing_lies_are_refused(ends, tmp_path):
    low, high, log = ends
    over = {"hyperparameters.learning_rate": {"low": low, "high": high, "log": log}}
    line = refusal(search, RECIPE, over, tmp_path / "search", 2)
    assert line.startswith("over.hyperparameters.learning_rate: ") and line.endswith("low < high, and low > 0 with log")


def test_a_setting_is_a_path_of_the_names_above_it(optuna, monkeypatch, tmp_path):
    ranges = []
    proposed = lambda study, number, over, seed: ranges.append(over) or {}  # noqa: E731
    over = {"hyperparameters": {"gamma": {"low": 0.5, "high": 0.9}}, "envs": {"choices": [2, 3]}}
    searched(monkeypatch, tmp_path, over=over, _proposed=proposed)
    assert ranges[0] == {"hyperparameters.gamma": {"low": 0.5, "high": 0.9}, "envs": {"choices": [2, 3]}}
