"""Hyperparameter search with Optuna: each trial is a training run in its folder, pruned by the median rule."""

import json
import sys
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from flexman_agents.callbacks import TrainingReport
from flexman_agents.settings import Settings
from flexman_agents.training import train_or_resume
from flexman_gym.common.checks import finite, mapping, one_of, sequence, whole_number
from flexman_gym.common.computer import computer_text, optional_module
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import write_atomically
from flexman_gym.common.parallel import Workers, parallel_map_unordered
from flexman_gym.envs.vector_env import compile_kernels

JOURNAL_FILE, BEST_FILE, STUDY_NAME = "study.log", "best.yaml", "flexman"
MAX_TRIALS = 100_000
EVALUATIONS = 10  # evaluations per trial if the recipe has no eval_every
STARTUP_TRIALS = 4  # number of first trials that the median rule does not prune


def search(
    recipe: Settings, over: Mapping[str, Any], folder: Path, trials: int, workers: Workers | int = 1, seed: int = 0
) -> Path:
    """Search for settings of a recipe with a higher mean return on the selection seeds, with Optuna.

    The TPE sampler proposes values, and the median rule prunes trials by the mean returns of their evaluations. A
    killed search is resumed with its unfinished trials; with one worker it proposes the values of an uninterrupted one.

    Args:
        recipe: settings common to all trials; trials are compared every `eval_every` environment steps, or ten times
            per training if `eval_every` is 0.
        over: search space, setting -> its range: a mapping with "low" and "high" (and optionally "log" or "whole",
            true), or with "choices", a list. A setting is a path such as "hyperparameters.gamma", or nested mappings.
        folder: folder for Optuna's journal, a run folder for each trial, and the best recipe.
        trials: total number of trials, including those in the folder.
        workers: workers, each for one trial at a time; parallel trials are proposed without the results of each other.
        seed: seed of the sampler.

    Returns:
        Path of best.yaml: the best trial as a recipe, with its provenance in a comment.

    Raises:
        ValueError: for a wrong range, or if no trial was completed.
        ImportError: without Optuna.
    """
    trials = whole_number("trials", trials, 1, MAX_TRIALS)
    if not recipe.eval_every:
        recipe = replace(recipe, eval_every=max(1, recipe.steps // EVALUATIONS))
    over = _flatten_ranges(over)
    for path in over:
        _check(path, over[path], recipe)
    folder.mkdir(parents=True, exist_ok=True)
    study, jobs = _study(folder), workers.jobs if isinstance(workers, Workers) else workers
    while True:
        running = [each.number for each in study.get_trials(deepcopy=False) if not each.state.is_finished()]
        while len(running) < jobs and len(study.get_trials(deepcopy=False)) < trials:
            running.append(study.ask().number)
            _proposed(study, running[-1], over, seed)  # drawn now, before trials in other processes end
        if not running:
            return _keep_best(study, recipe, folder)
        proposed = {number: _proposed(study, number, over, seed) for number in running}
        cells = [(_change_settings(recipe, values), str(folder), number) for number, values in proposed.items()]
        for _ in parallel_map_unordered(_run_trial, cells, workers, prepare=compile_kernels):
            pass


def _run_trial(cell: tuple[Settings, str, int]) -> None:
    """Train a trial to its end or until it is pruned, report it to the study, and resume it after a kill.

    Args:
        cell: settings of the trial, folder of the search, and number of the trial.
    """
    settings, folder, number = cell
    study, place = _study(Path(folder)), Path(folder) / f"trial-{number}"
    trial, evaluations = _trial(study, number), [dict[str, float]()]
    # True for a trial that was killed after it was pruned.
    pruned = bool(trial._cached_frozen_trial.intermediate_values) and bool(trial.should_prune())

    def hook(report: TrainingReport) -> bool:
        nonlocal pruned
        if report.metrics and report.metrics != evaluations[-1]:
            evaluations.append(dict(report.metrics))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # the step was reported before the trial was killed
                trial.report(report.metrics["reward"], report.steps)
            report.save()
            pruned = report.steps < settings.steps and trial.should_prune()
        return pruned

    try:
        if not pruned:
            train_or_resume((settings, str(place), {"progress": False, "hook": hook}))
    except ValueError as error:  # the training diverged
        print(f"trial {number}: {error}", file=sys.stderr)
        study.tell(number, state=_optuna().trial.TrialState.FAIL)
        return
    rewards = study.get_trials(deepcopy=False)[number].intermediate_values.values()
    if pruned:
        study.tell(number, state=_optuna().trial.TrialState.PRUNED)
    else:
        study.tell(number, max(rewards))


def _flatten_ranges(over: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return path of a setting -> its range, from nested mappings or paths."""
    result: dict[str, Any] = {}
    for name, given in over.items():
        nested = isinstance(given, dict) and not {"low", "high", "choices"} & given.keys()
        result |= _flatten_ranges(given, f"{path}{name}.") if nested else {f"{path}{name}": given}
    return result


def _change_settings(recipe: Settings, values: Mapping[str, Any]) -> Settings:
    """Change settings of a recipe.

    Args:
        recipe: settings.
        values: path of a setting, such as "hyperparameters.gamma" -> value.
    """
    data = json.loads(json.dumps(recipe.plain()))
    for path, value in values.items():
        *parts, last = path.split(".")
        inner = data
        for part in parts:
            inner = inner.setdefault(part, {})
        inner[last] = value
    return Settings.from_dict(data)


def _check(path: str, given: Any, recipe: Settings) -> None:
    """Check that a recipe has the setting `path` and accepts both ends of its range, or all choices."""
    field = f"over.{path}"
    if isinstance(given, dict) and "choices" in given:
        values = sequence(f"{field}.choices", mapping(field, given, ("choices",))["choices"])
    else:
        span = mapping(field, given, ("low", "high", "log", "whole"))
        if not {"low", "high"} <= span.keys():
            raise value_error(field, given, "a mapping with low and high, or with choices")
        values = [finite(f"{field}.{name}", span[name]) for name in ("low", "high")]
        if not values[0] < values[1] or (span.get("log") and values[0] <= 0.0):
            raise value_error(field, given, "low < high, and low > 0 with log")
        values = [int(value) if span.get("whole") else value for value in values]
    one_of(field, path.partition(".")[0], sorted({*recipe.plain()} - {"algo", "steps", "eval_every"}))
    for value in values:
        _change_settings(recipe, {path: value})


def _proposed(study: Any, number: int, over: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Return the values of a trial by path of the setting; the sampler draws them at the first call.

    Each value has a seed of its own, so that a search that is killed between two draws draws the same rest.
    """
    trial = _trial(study, number)
    result = {}
    for i, (path, span) in enumerate(over.items()):
        own = int(np.random.SeedSequence([seed, number, i]).generate_state(1)[0])
        study.sampler = _optuna().samplers.TPESampler(seed=own)
        if "choices" in span:
            result[path] = trial.suggest_categorical(path, span["choices"])
        else:
            suggest = trial.suggest_int if span.get("whole") else trial.suggest_float
            result[path] = suggest(path, span["low"], span["high"], log=bool(span.get("log")))
    return result


def _keep_best(study: Any, recipe: Settings, folder: Path) -> Path:
    """Write the best trial as a recipe; return its path."""
    best = study.best_trial
    finished = [each.state.name.lower() for each in study.get_trials(deepcopy=False)]
    counts = ", ".join(f"{finished.count(state)} {state}" for state in sorted(set(finished)))
    settings = _change_settings(recipe, best.params)
    lines = [f"Found by flexman search: trial {best.number} of {len(finished)} ({counts}).",
             f"Mean reward on the selection seeds: {best.value!r}.",
             *(f"{path}: {value!r}" for path, value in best.params.items()),
             computer_text(("optuna", "torch"))]  # fmt: skip
    text = "".join(f"# {line}\n" for line in lines) + yaml.safe_dump(json.loads(json.dumps(settings.plain())))
    write_atomically(folder / BEST_FILE, lambda file: file.write(text.encode()))
    return folder / BEST_FILE


def _trial(study: Any, number: int) -> Any:
    """Return a trial of a study; another process may have started the trial."""
    return _optuna().trial.Trial(study, study.get_trials(deepcopy=False)[number]._trial_id)


def _study(folder: Path) -> Any:
    """Return the study in a folder; several processes can write to its journal."""
    optuna = _optuna()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    backend = optuna.storages.journal.JournalFileBackend(str(folder / JOURNAL_FILE))
    return optuna.create_study(
        storage=optuna.storages.JournalStorage(backend),
        study_name=STUDY_NAME,
        direction="maximize",
        load_if_exists=True,
        pruner=optuna.pruners.MedianPruner(n_startup_trials=STARTUP_TRIALS),
    )  # fmt: skip


def _optuna() -> Any:
    return optional_module("optuna", "a search", "scale")
