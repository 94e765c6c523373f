"""Hyperparameter search with Optuna: each trial is a training run in its folder, pruned by the median rule."""

import json
import sys
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from flexman_agents.callbacks import TrainingReport
from flexman_agents.settings import Settings
from flexman_agents.training import train_or_resume
from flexman_gym.common.checks import finite, mapping, one_of, sequence, value_error, whole_number
from flexman_gym.common.computer import computer_text
from flexman_gym.common.files import write_atomically
from flexman_gym.common.parallel import Workers, parallel_map_unordered
from flexman_gym.envs.vector_env import compile_kernels

JOURNAL_FILE, BEST_FILE, STUDY_NAME = "study.log", "best.yaml", "flexman"
MAX_TRIALS, EVALUATIONS = 100_000, 10  # evaluations of a trial where the recipe asks for none
STARTUP_TRIALS = 4  # trials that are not pruned, against which others are


def search(
    recipe: Settings, over: Mapping[str, Any], folder: Path, trials: int, workers: Workers | int = 1, seed: int = 0
) -> Path:
    """Looks for settings with which a recipe earns more on the selection seeds.

    Values are proposed by the TPE sampler of Optuna; the median rule prunes a trial by its rewards on the way. A search
    that was killed goes on, its trials included, and proposes what it would have proposed, one trial at a time.

    Args:
        recipe: of all trials; `judge_every` says how often they are compared, a tenth of the steps where it is 0.
        over: path of a setting, such as "hyperparameters.gamma" -> mapping with "low" and "high" (with "log" or "whole"
            where these are true), or with "choices", a list.
        folder: for Optuna's journal, a folder for each trial, and the best one.
        trials: in all, those in the folder included.
        workers: who trains; several trials at once are proposed without knowing of each other.
        seed: of the sampler.

    Returns:
        The file best.yaml: the best trial as a recipe, with its provenance above it.

    Raises:
        ValueError: one line; also where no trial came to its end.
        ImportError: without Optuna.
    """
    trials = whole_number("trials", trials, 1, MAX_TRIALS)
    if not recipe.judge_every:
        recipe = replace(recipe, judge_every=max(1, recipe.steps // EVALUATIONS))
    for path in over:
        _check(path, over[path], recipe)
    folder.mkdir(parents=True, exist_ok=True)
    study, jobs = _study(folder), workers.jobs if isinstance(workers, Workers) else workers
    while True:
        begun = [each.number for each in study.get_trials(deepcopy=False) if not each.state.is_finished()]
        while len(begun) < jobs and len(study.get_trials(deepcopy=False)) < trials:
            study.sampler = _optuna().samplers.TPESampler(seed=seed + len(study.get_trials(deepcopy=False)))
            begun.append(study.ask().number)
            _proposed(study, begun[-1], over)  # before anything can be killed that another sampler would go on with
        if not begun:
            return _keep_best(study, recipe, folder)
        cells = [(change_settings(recipe, _proposed(study, number, over)), str(folder), number) for number in begun]
        for _ in parallel_map_unordered(run_trial, cells, workers, prepare=compile_kernels):
            pass


def run_trial(cell: tuple[Settings, str, int]) -> None:
    """Trains a trial to its end, or until it is pruned, and tells the study; goes on where it was killed."""
    settings, folder, number = cell
    study, place = _study(Path(folder)), Path(folder) / f"trial-{number}"
    trial, known = _trial(study, number), [dict[str, float]()]
    pruned = bool(trial._cached_frozen_trial.intermediate_values) and bool(trial.should_prune())  # and then killed

    def hook(report: TrainingReport) -> bool:
        nonlocal pruned
        if report.figures and report.figures != known[-1]:
            known.append(dict(report.figures))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # of what was told before the trial was killed
                trial.report(report.figures["reward"], report.steps)
            report.save()
            pruned = report.steps < settings.steps and trial.should_prune()
        return pruned

    try:
        if not pruned:
            train_or_resume((settings, str(place), {"progress": False, "hook": hook}))
    except ValueError as error:  # what diverges is a trial that failed
        print(f"trial {number}: {error}", file=sys.stderr)
        study.tell(number, state=_optuna().trial.TrialState.FAIL)
        return
    rewards = study.get_trials(deepcopy=False)[number].intermediate_values.values()
    if pruned:
        study.tell(number, state=_optuna().trial.TrialState.PRUNED)
    else:
        study.tell(number, max(rewards))


def flatten_ranges(over: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Gives path -> what a setting may be, from mappings in mappings as a file has them."""
    result: dict[str, Any] = {}
    for name, said in over.items():
        inner = isinstance(said, dict) and not {"low", "high", "choices"} & said.keys()
        result |= flatten_ranges(said, f"{path}{name}.") if inner else {f"{path}{name}": said}
    return result


def change_settings(recipe: Settings, values: Mapping[str, Any]) -> Settings:
    """Gives a recipe with other values of some settings, by their paths."""
    data = json.loads(json.dumps(recipe.plain()))
    for path, value in values.items():
        *parts, last = path.split(".")
        inner = data
        for part in parts:
            inner = inner.setdefault(part, {})
        inner[last] = value
    return Settings.from_dict(data)


def _check(path: str, said: Any, recipe: Settings) -> None:
    """Refuses a setting that a recipe cannot have, and what says no values."""
    field = f"over.{path}"
    if isinstance(said, dict) and "choices" in said:
        values = sequence(f"{field}.choices", mapping(field, said, ("choices",))["choices"])
    else:
        given = mapping(field, said, ("low", "high", "log", "whole"))
        if not {"low", "high"} <= given.keys():
            raise value_error(field, said, "a mapping with low and high, or with choices")
        values = [finite(f"{field}.{name}", given[name]) for name in ("low", "high")]
        if not values[0] < values[1] or (given.get("log") and values[0] <= 0.0):
            raise value_error(field, said, "low < high, and low > 0 with log")
        values = [int(value) if given.get("whole") else value for value in values]
    one_of(field, path.partition(".")[0], sorted({*recipe.plain()} - {"algo", "steps", "judge_every"}))
    for value in values:
        change_settings(recipe, {path: value})


def _proposed(study: Any, number: int, over: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a trial, which the sampler proposes the first time."""
    trial = _trial(study, number)
    result = {}
    for path, said in over.items():
        if "choices" in said:
            result[path] = trial.suggest_categorical(path, said["choices"])
        else:
            suggest = trial.suggest_int if said.get("whole") else trial.suggest_float
            result[path] = suggest(path, said["low"], said["high"], log=bool(said.get("log")))
    return result


def _keep_best(study: Any, recipe: Settings, folder: Path) -> Path:
    """Writes the best trial as a recipe."""
    best = study.best_trial
    finished = [each.state.name.lower() for each in study.get_trials(deepcopy=False)]
    counts = ", ".join(f"{finished.count(state)} {state}" for state in sorted(set(finished)))
    settings = change_settings(recipe, best.params)
    words = [f"Found by flexman search: trial {best.number} of {len(finished)} ({counts}).",
             f"Mean reward on the selection seeds: {best.value!r}.",
             *(f"{path}: {value!r}" for path, value in best.params.items()),
             computer_text(("optuna", "torch"))]  # fmt: skip
    text = "".join(f"# {line}\n" for line in words) + yaml.safe_dump(json.loads(json.dumps(settings.plain())))
    write_atomically(folder / BEST_FILE, lambda file: file.write(text.encode()))
    return folder / BEST_FILE


def _trial(study: Any, number: int) -> Any:
    """A trial of a study, also one that another process has begun."""
    return _optuna().trial.Trial(study, study.get_trials(deepcopy=False)[number]._trial_id)


def _study(folder: Path) -> Any:
    """The study in a folder, whose journal several processes may write."""
    optuna = _optuna()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    backend = optuna.storages.journal.JournalFileBackend(str(folder / JOURNAL_FILE))
    return optuna.create_study(
        storage=optuna.storages.JournalStorage(backend), study_name=STUDY_NAME, direction="maximize", load_if_exists=True,
        pruner=optuna.pruners.MedianPruner(n_startup_trials=STARTUP_TRIALS),
    )  # fmt: skip


def _optuna() -> Any:
    try:
        import optuna
    except ImportError:
        raise ImportError("a search needs Optuna: pip install 'flexman_gym[scale]'") from None
    return optuna
