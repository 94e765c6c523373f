"""Training: PPO or SAC on an environment; a run is kept in one folder, survives its process and goes on exactly."""

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from flexman_agents.algorithm import acting, make_model
from flexman_agents.callbacks import Checkpoints, Exploration, Hook, Judge, Report, ValueFirst
from flexman_agents.curves import open_curves
from flexman_agents.imitation import Lessons
from flexman_agents.interruption import Interrupted, asked_to_stop
from flexman_agents.memory import give_policy, give_training, take_policy, take_training
from flexman_agents.record import check_new, keep_settings
from flexman_agents.settings import EXPLORATION, MOST_STEPS, Settings
from flexman_gym.checks import refusal, whole_number
from flexman_gym.envs.snapshot import give, take
from flexman_gym.evaluation.folder import (
    BEST,
    NEWEST,
    SETTINGS,
    check_settings,
    locked,
    read_data,
    read_settings,
    settings_text,
    write_data,
)


def train(
    settings: Settings,
    folder: str | Path,
    checkpoint_every: int = 0,
    progress: bool = True,
    device: str = "cpu",
    hook: Hook | None = None,
) -> BaseAlgorithm | None:
    """Trains a policy from the start and saves it in a folder.

    An imitation ("dagger") keeps its policy alone, and that at the end.

    Args:
        settings: what the run is.
        folder: for settings.json (with versions), newest.npz (the whole run), best.npz (the best policy on the way),
            and the curves in progress.csv and as TensorBoard events.
        checkpoint_every: steps between savings; 0: only at the end.
        progress: show a bar.
        device: of the networks, as PyTorch names it.
        hook: is told how far the run is; it stops, and is kept, where the hook gives True.

    Returns:
        The model of Stable-Baselines3; None for an imitation.

    Raises:
        ValueError: when the folder holds a run already, or another process trains in it.
        OSError: when the folder cannot be written.
        Interrupted: after Ctrl-C, once the run is saved.
    """
    folder = Path(folder)
    check_new(folder)
    checkpoint_every = whole_number("checkpoint_every", checkpoint_every, 0, MOST_STEPS)
    run = _begun(settings, folder, device)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        check_new(folder)  # another process may have trained there meanwhile
        keep_settings(settings, folder, 0)
        return run.learn(checkpoint_every, progress, hook)


def resume(
    folder: Path,
    steps: int | None = None,
    checkpoint_every: int = 0,
    progress: bool = True,
    device: str = "cpu",
    judge_every: int | None = None,
    hook: Hook | None = None,
) -> BaseAlgorithm | None:
    """Goes on with the run in a folder to the end of its steps, exactly as if it had never stopped.

    A run that is finished goes on only where `steps` are given, as another run that begins with its policy and its
    memory and whose schedules begin anew. The curves are in progress-STEPS.csv, after so many steps. It is judged as
    often as before where nothing else is said.

    Raises:
        FileNotFoundError: when there is no run.
        ValueError: for steps of an unfinished run and none of a finished one; when the run keeps its best policy, which
            is what acts, and would not be judged any more; and as `train`.
        OSError, Interrupted: as `train`.
    """
    checkpoint_every = whole_number("checkpoint_every", checkpoint_every, 0, MOST_STEPS)
    settings = load_settings(folder)
    with locked(folder):
        data = read_data(folder / NEWEST) if (folder / NEWEST).is_file() else None
        if data is not None:
            check_settings(folder / NEWEST, data, read_settings(folder))
        done = 0 if data is None else _steps_done(folder / NEWEST, data)
        finished = data is not None and done >= settings.steps
        settings = _further(settings, folder, steps, done, finished)
        if judge_every is not None:
            settings = replace(settings, judge_every=judge_every)
        if (folder / BEST).is_file() and not settings.judge_every:
            allowed = f"the steps between evaluations, > 0: {folder} keeps its best policy"
            raise refusal("judge_every", settings.judge_every, allowed)
        run = _begun(settings, folder, device)
        if data is None:
            print(f"Nothing was kept in {folder} yet: the run begins again.", file=sys.stderr)
        else:
            run.give(data, finished)
        keep_settings(settings, folder, run.done)
        return run.learn(checkpoint_every, progress, hook)


def trained(cell: tuple[Settings, str, Mapping[str, Any]]) -> str:
    """Trains a run as `train` does, or goes on with it to its end; a cell of a grid.

    Args:
        cell: the settings, the folder as a text, and what both `train` and `resume` take by name, a mapping.

    Returns:
        The folder.

    Raises:
        ValueError: also where the folder holds a run with other settings.
    """
    settings, folder, how = cell
    path = Path(folder)
    if not (path / SETTINGS).exists():
        train(settings, path, **how)
        return folder
    if load_settings(path) != settings:
        raise refusal("folder", folder, "one without a run of other settings")
    if not (path / NEWEST).is_file() or _steps_done(path / NEWEST, read_data(path / NEWEST)) < settings.steps:
        resume(path, **how)
    return folder


def load_settings(folder: Path) -> Settings:
    """Reads the settings of the run in a folder.

    Raises:
        FileNotFoundError, ValueError: one clear line.
    """
    return Settings.from_json(folder / SETTINGS, settings_text(folder))


def _begun(settings: Settings, folder: Path, device: str) -> "_Run | Lessons":
    """A run at its beginning."""
    if settings.algo == "dagger":
        return Lessons(settings, folder)
    return _Run(make_model(settings, device), settings, folder)


class _Run:
    """A model that learns in a folder, and what it was before."""

    def __init__(self, model: BaseAlgorithm, settings: Settings, folder: Path) -> None:
        self.model, self.settings, self.folder = model, settings, folder
        self._before = 0  # steps of runs that this one followed
        self._judge: Judge | None = None
        if settings.judge_every:
            statistics = model.get_vec_normalize_env()
            assert statistics is not None
            self._judge = Judge(settings, acting(model, statistics), self._keep_best)

    @property
    def done(self) -> int:
        """Steps that have been taken, those of runs before this one included."""
        return self._before + int(self.model.num_timesteps)

    def give(self, data: dict[str, Any], another: bool) -> None:
        """Puts everything where it was when it was saved; another run counts its steps from there."""
        path = self.folder / NEWEST
        try:
            give_policy(self.model, data)
            give_training(self.model, data["training"])
            if self._judge and data["judge"] is not None:
                give("judge", self._judge, data["judge"])
            self._before = whole_number("before", data["before"], 0, MOST_STEPS)
        except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
            said = " ".join(str(error).split()) or type(error).__name__
            raise ValueError(f"{path}: {said}") from None
        if another:
            count = self.model.num_timesteps
            print(
                f"The run of {count} steps was finished: {self.settings.steps} more are another run.", file=sys.stderr
            )
            self._before += count
            self.model.num_timesteps, self.model._current_progress_remaining = 0, 1.0
            if self._judge:
                self._judge.begin()

    def learn(self, checkpoint_every: int, progress: bool, hook: Hook | None) -> BaseAlgorithm:
        """Learns to the end of the steps, or until it is told to stop."""
        model, settings = self.model, self.settings
        callbacks: list[BaseCallback] = []
        for exploration in filter(None, map(settings.schedule, EXPLORATION)):
            callbacks.append(Exploration(exploration, settings.steps))
        if settings.value_first:
            callbacks.append(ValueFirst(settings.value_first))
        if self._judge:
            callbacks.append(self._judge)
        told: dict[str, Any] = {"progress_bar": progress, "reset_num_timesteps": False}
        if isinstance(model, OffPolicyAlgorithm):
            told["log_interval"] = settings.envs  # SAC logs after so many episodes, which end together
        with asked_to_stop() as asked:
            model.set_logger(open_curves(self.folder, self._before, model.num_timesteps))
            stop = (lambda: asked.is_set() or bool(hook(self._report()))) if hook else asked.is_set
            checkpoints = Checkpoints(checkpoint_every, self._save, stop)
            model.learn(settings.steps - model.num_timesteps, callback=[checkpoints, *callbacks], **told)
        model.get_env().close()  # type: ignore[union-attr]
        if checkpoints.stopped is not None and asked.is_set():
            raise Interrupted(f"{self.folder}: stopped after {checkpoints.stopped} steps, all of which are kept")
        if checkpoints.stopped is None:
            self._save()
            if hook:
                hook(self._report())
        return model

    def _report(self) -> Report:
        return Report(self.done, dict(self._judge.latest) if self._judge else {}, self._save)

    def _save(self) -> None:
        judge = take(self._judge) if self._judge else None
        data = {"training": take_training(self.model), "judge": judge, "before": self._before}
        write_data(self.folder / NEWEST, self._policy() | data)

    def _keep_best(self) -> None:
        write_data(self.folder / BEST, self._policy())

    def _policy(self) -> dict[str, Any]:
        """The policy with the settings that it belongs to."""
        return take_policy(self.model) | {"settings": self.settings.plain()}


def _steps_done(path: Path, data: Any) -> int:
    try:
        return whole_number("num_timesteps", data["training"]["counts"]["num_timesteps"], 0, MOST_STEPS)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: {' '.join(str(error).split())} is wrong in what the run remembers") from None


def _further(settings: Settings, folder: Path, steps: int | None, done: int, finished: bool) -> Settings:
    """The settings with which a run goes on."""
    if finished and steps is None:
        raise ValueError(f"steps: None is not allowed; give those of another run: that in {folder} is finished")
    if not finished and steps is not None:
        allowed = f"nothing: the run in {folder} has {done} of its {settings.steps} steps and goes on to its end"
        raise refusal("steps", steps, allowed)
    return settings if steps is None else replace(settings, steps=steps)
