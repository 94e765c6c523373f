"""Training: PPO, SAC or DAgger in a run folder, with its complete state and exact resumption."""

import random
import sys
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from flexman_agents.callbacks import (
    Checkpoints,
    Evaluation,
    Exploration,
    Hook,
    Interrupted,
    TrainingReport,
    ValueWarmup,
    open_logger,
    stop_on_interrupt,
)
from flexman_agents.imitation import DAggerRun
from flexman_agents.sb3 import action_function, make_model
from flexman_agents.settings import EXPLORATION_SCHEDULES, MAX_STEPS, Settings, check_new_folder, write_settings
from flexman_agents.vector import SB3VecEnv
from flexman_gym.common.checks import value_error, whole_number
from flexman_gym.common.run_folder import (
    BEST,
    NEWEST,
    SETTINGS,
    lock_folder,
    read_npz,
    read_settings,
    read_settings_text,
    write_npz,
)
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.evaluation.agent import check_settings

COUNTERS = ("num_timesteps", "_n_updates", "_episode_num", "_current_progress_remaining")
LAST_FIELDS = ("_last_obs", "_last_original_obs", "_last_episode_starts")
NORMALISER_FIELDS = ("old_obs", "old_reward")
MONITOR_FIELDS = ("episode_returns", "episode_lengths", "episode_count")
REPLAY_FIELDS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
STATISTICS_FIELDS = ("mean", "var", "count")


def policy_state(model: BaseAlgorithm) -> dict[str, Any]:
    """Gives what acts: the parameters of the networks and the statistics that normalise what they see."""
    return {"policy": _of_tensors(model.policy.state_dict()), "statistics": _of_statistics(_normaliser(model).obs_rms)}


def _set_policy_state(model: BaseAlgorithm, data: Any) -> None:
    """Gives networks and statistics back to a model made alike.

    Raises:
        ValueError: one line, for those of other networks or other observations.
    """
    _check(data, ("policy", "statistics"))
    model.policy.load_state_dict(_tensors("policy", model.policy.state_dict(), data["policy"]))
    _give_statistics("statistics", _normaliser(model).obs_rms, data["statistics"])


def _training_state(model: BaseAlgorithm) -> dict[str, Any]:
    """Gives all that a model remembers at the beginning of a rollout, beside its policy."""
    result: dict[str, Any] = {
        "counts": {name: getattr(model, name) for name in _counts(model)},
        "last": {name: get_state(getattr(model, name)) for name in LAST_FIELDS},
        "optimizers": {name: _of_optimizer(each) for name, each in _optimizers(model).items()},
        "episodes": [[float(each[key]) for key in "rlt"] for each in model.ep_info_buffer or ()],
        "random": _of_random(),
    }
    normaliser, monitor, arms = _layers(model)
    result["returns"] = {"statistics": _of_statistics(normaliser.ret_rms), "running": normaliser.returns.copy()}
    result["seen"] = {name: get_state(getattr(normaliser, name)) for name in NORMALISER_FIELDS}
    result["monitor"] = {name: get_state(getattr(monitor, name)) for name in MONITOR_FIELDS}
    result["environment"] = arms.env.unwrapped.get_state()  # type: ignore[attr-defined]
    if isinstance(model, SAC):
        learned = model.log_ent_coef
        result["entropy"] = None if learned is None else learned.detach().numpy().copy()
        result["replay"] = _of_replay(model)
    return result


def _set_training_state(model: BaseAlgorithm, data: Any) -> None:
    """Gives the same back to a model made alike.

    Raises:
        ValueError: one line, for what another model remembers.
    """
    names = ["counts", "last", "optimizers", "episodes", "random", "returns", "seen", "monitor", "environment"]
    _check(data, names + ["entropy", "replay"] * isinstance(model, SAC))
    normaliser, monitor, arms = _layers(model)
    for part, wanted in (
        ("counts", _counts(model)),
        ("last", LAST_FIELDS),
        ("seen", NORMALISER_FIELDS),
        ("monitor", MONITOR_FIELDS),
    ):
        _check(data[part], wanted, part)
    arms.env.unwrapped.set_state(data["environment"])  # type: ignore[attr-defined]
    for name in _counts(model):
        setattr(model, name, data["counts"][name])
    for name in LAST_FIELDS:
        setattr(model, name, get_state(data["last"][name]))
    for name, optimizer in _optimizers(model).items():
        _give_optimizer(name, optimizer, data["optimizers"].get(name))
    told = [dict(zip("rlt", each, strict=True)) for each in data["episodes"]]
    model.ep_info_buffer = deque(told, maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)  # no task of ours says success
    _give_statistics("returns", normaliser.ret_rms, data["returns"]["statistics"])
    set_state("returns", normaliser.returns, data["returns"]["running"])
    for name in NORMALISER_FIELDS:
        setattr(normaliser, name, get_state(data["seen"][name]))
    for name in MONITOR_FIELDS:
        setattr(monitor, name, get_state(data["monitor"][name]))
    if isinstance(model, SAC):
        if model.log_ent_coef is not None:
            logarithm = model.log_ent_coef.detach().numpy().copy()
            model.log_ent_coef.data = torch.as_tensor(set_state("entropy", logarithm, data["entropy"]))
        _give_replay(model, data["replay"])
    _give_random(data["random"])


def _layers(model: BaseAlgorithm) -> tuple[VecNormalize, VecMonitor, SB3VecEnv]:
    """What stands between a model and its arms."""
    normaliser = _normaliser(model)
    monitor: Any = normaliser.venv
    return normaliser, monitor, monitor.venv


def _normaliser(model: BaseAlgorithm) -> VecNormalize:
    result = model.get_vec_normalize_env()
    assert result is not None
    return result


def _counts(model: BaseAlgorithm) -> list[str]:
    return [name for name in COUNTERS if hasattr(model, name)]


def _check(data: Any, names: Collection[str], field: str = "run") -> None:
    if not isinstance(data, dict) or not set(names) <= data.keys():
        result = sorted(data) if isinstance(data, dict) else type(data).__name__
        raise value_error(field, result, f"what a run remembers: {', '.join(names)}")


def _of_tensors(tensors: Any) -> dict[str, Any]:
    return {name: tensor.detach().cpu().numpy().copy() for name, tensor in tensors.items()}


def _tensors(field: str, like: Any, arrays: Any) -> dict[str, torch.Tensor]:
    if not isinstance(arrays, dict) or arrays.keys() != like.keys():
        raise value_error(field, sorted(arrays) if isinstance(arrays, dict) else arrays, f"arrays {', '.join(like)}")
    wanted = _of_tensors(like)
    return {name: torch.as_tensor(_finite(f"{field}.{name}", wanted[name], arrays[name])) for name in like}


def _finite(field: str, old: NDArray[Any], data: Any, least: float = -np.inf) -> Any:
    """Gives data back to an array, once all of its numbers are finite and none is below the least."""
    result = set_state(field, old, data)
    if not (np.isfinite(result) & (np.asarray(result) >= least)).all():
        allowed = "finite numbers" if least < 0.0 else "finite numbers >= 0"
        raise value_error(field, "another number", allowed)
    return result


def _of_statistics(moments: Any) -> dict[str, Any]:
    return {name: np.array(getattr(moments, name), dtype=np.float64) for name in STATISTICS_FIELDS}


def _give_statistics(field: str, moments: Any, data: Any) -> None:
    for name, value in _of_statistics(moments).items():
        given = data.get(name) if isinstance(data, dict) else None
        result = _finite(f"{field}.{name}", value, given, -np.inf if name == "mean" else 0.0)
        setattr(moments, name, result if result.ndim else result.item() if name == "count" else np.float64(result))


def _optimizers(model: BaseAlgorithm) -> dict[str, torch.optim.Optimizer]:
    if not isinstance(model, SAC):
        return {"policy": model.policy.optimizer}
    result = {"actor": model.actor.optimizer, "critic": model.critic.optimizer}
    return result | ({"entropy": model.ent_coef_optimizer} if model.ent_coef_optimizer else {})


def _of_optimizer(optimizer: torch.optim.Optimizer) -> dict[str, Any]:
    """What an optimiser remembers of each parameter; its settings belong to the model."""
    return {str(key): _of_tensors(each) for key, each in optimizer.state_dict()["state"].items()}


def _give_optimizer(field: str, optimizer: torch.optim.Optimizer, data: Any) -> None:
    plain = optimizer.state_dict()
    if not isinstance(data, dict) or not data.keys() <= {str(i) for i in plain["param_groups"][0]["params"]}:
        raise value_error(
            f"optimizers.{field}", data if data is None else sorted(data), "what the optimiser remembered"
        )
    state = {int(key): {name: torch.as_tensor(value) for name, value in each.items()} for key, each in data.items()}
    optimizer.load_state_dict({"state": state, "param_groups": plain["param_groups"]})


def _of_replay(model: SAC) -> dict[str, Any]:
    buffer: Any = model.replay_buffer
    rows = buffer.buffer_size if buffer.full else buffer.pos
    return {"pos": int(buffer.pos), "full": bool(buffer.full)} | {
        name: getattr(buffer, name)[:rows] for name in REPLAY_FIELDS
    }


def _give_replay(model: SAC, data: Any) -> None:
    buffer: Any = model.replay_buffer
    rows = buffer.buffer_size if data["full"] else data["pos"]
    for name in REPLAY_FIELDS:
        set_state(f"replay.{name}", getattr(buffer, name)[:rows], data[name])
    buffer.pos, buffer.full = data["pos"], data["full"]


def _of_random() -> dict[str, Any]:
    """The states of the generators that Python, NumPy and PyTorch share with everybody."""
    version, words, gauss = random.getstate()
    kind, keys, *rest = np.random.get_state(legacy=True)  # noqa: NPY002, Stable-Baselines3 draws from it
    return {
        "python": [version, list(words), gauss],
        "numpy": [kind, np.asarray(keys), *(each if isinstance(each, str) else float(each) for each in rest)],
        "torch": torch.get_rng_state().numpy().copy(),
    }


def _give_random(data: dict[str, Any]) -> None:
    version, words, gauss = data["python"]
    random.setstate((version, tuple(words), gauss))
    kind, keys, position, has, gaussian = data["numpy"]
    np.random.set_state((kind, keys, int(position), int(has), gaussian))  # noqa: NPY002
    torch.set_rng_state(torch.as_tensor(data["torch"]))


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
    check_new_folder(folder)
    checkpoint_every = whole_number("checkpoint_every", checkpoint_every, 0, MAX_STEPS)
    run = _new_run(settings, folder, device)
    folder.mkdir(parents=True, exist_ok=True)
    with lock_folder(folder):
        check_new_folder(folder)  # another process may have trained there meanwhile
        write_settings(settings, folder, 0)
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
    checkpoint_every = whole_number("checkpoint_every", checkpoint_every, 0, MAX_STEPS)
    settings = load_settings(folder)
    with lock_folder(folder):
        data = read_npz(folder / NEWEST) if (folder / NEWEST).is_file() else None
        if data is not None:
            check_settings(folder / NEWEST, data, read_settings(folder))
        done = 0 if data is None else _steps_done(folder / NEWEST, data)
        finished = data is not None and done >= settings.steps
        settings = _further(settings, folder, steps, done, finished)
        if judge_every is not None:
            settings = replace(settings, judge_every=judge_every)
        if (folder / BEST).is_file() and not settings.judge_every:
            allowed = f"the steps between evaluations, > 0: {folder} keeps its best policy"
            raise value_error("judge_every", settings.judge_every, allowed)
        run = _new_run(settings, folder, device)
        if data is None:
            print(f"Nothing was kept in {folder} yet: the run begins again.", file=sys.stderr)
        else:
            run.set_state(data, finished)
        write_settings(settings, folder, run.done)
        return run.learn(checkpoint_every, progress, hook)


def train_or_resume(cell: tuple[Settings, str, Mapping[str, Any]]) -> str:
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
        raise value_error("folder", folder, "one without a run of other settings")
    if not (path / NEWEST).is_file() or _steps_done(path / NEWEST, read_npz(path / NEWEST)) < settings.steps:
        resume(path, **how)
    return folder


def load_settings(folder: Path) -> Settings:
    """Reads the settings of the run in a folder.

    Raises:
        FileNotFoundError, ValueError: one clear line.
    """
    return Settings.from_json(folder / SETTINGS, read_settings_text(folder))


def _new_run(settings: Settings, folder: Path, device: str) -> "_Run | DAggerRun":
    """A run at its beginning."""
    if settings.algo == "dagger":
        return DAggerRun(settings, folder)
    return _Run(make_model(settings, device), settings, folder)


class _Run:
    """A model that learns in a folder, and what it was before."""

    def __init__(self, model: BaseAlgorithm, settings: Settings, folder: Path) -> None:
        self.model, self.settings, self.folder = model, settings, folder
        self._before = 0  # steps of runs that this one followed
        self._judge: Evaluation | None = None
        if settings.judge_every:
            statistics = model.get_vec_normalize_env()
            assert statistics is not None
            self._judge = Evaluation(settings, action_function(model, statistics), self._keep_best)

    @property
    def done(self) -> int:
        """Steps that have been taken, those of runs before this one included."""
        return self._before + int(self.model.num_timesteps)

    def set_state(self, data: dict[str, Any], another: bool) -> None:
        """Puts everything where it was when it was saved; another run counts its steps from there."""
        path = self.folder / NEWEST
        try:
            _set_policy_state(self.model, data)
            _set_training_state(self.model, data["training"])
            if self._judge and data["judge"] is not None:
                set_state("judge", self._judge, data["judge"])
            self._before = whole_number("before", data["before"], 0, MAX_STEPS)
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
        for exploration in filter(None, map(settings.schedule, EXPLORATION_SCHEDULES)):
            callbacks.append(Exploration(exploration, settings.steps))
        if settings.value_first:
            callbacks.append(ValueWarmup(settings.value_first))
        if self._judge:
            callbacks.append(self._judge)
        told: dict[str, Any] = {"progress_bar": progress, "reset_num_timesteps": False}
        if isinstance(model, OffPolicyAlgorithm):
            told["log_interval"] = settings.envs  # SAC logs after so many episodes, which end together
        with stop_on_interrupt() as asked:
            model.set_logger(open_logger(self.folder, self._before, model.num_timesteps))
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

    def _report(self) -> TrainingReport:
        return TrainingReport(self.done, dict(self._judge.latest) if self._judge else {}, self._save)

    def _save(self) -> None:
        judge = get_state(self._judge) if self._judge else None
        data = {"training": _training_state(self.model), "judge": judge, "before": self._before}
        write_npz(self.folder / NEWEST, self._policy() | data)

    def _keep_best(self) -> None:
        write_npz(self.folder / BEST, self._policy())

    def _policy(self) -> dict[str, Any]:
        """The policy with the settings that it belongs to."""
        return policy_state(self.model) | {"settings": self.settings.plain()}


def _steps_done(path: Path, data: Any) -> int:
    try:
        return whole_number("num_timesteps", data["training"]["counts"]["num_timesteps"], 0, MAX_STEPS)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: {' '.join(str(error).split())} is wrong in what the run remembers") from None


def _further(settings: Settings, folder: Path, steps: int | None, done: int, finished: bool) -> Settings:
    """The settings with which a run goes on."""
    if finished and steps is None:
        raise ValueError(f"steps: None is not allowed; give those of another run: that in {folder} is finished")
    if not finished and steps is not None:
        allowed = f"nothing: the run in {folder} has {done} of its {settings.steps} steps and goes on to its end"
        raise value_error("steps", steps, allowed)
    return settings if steps is None else replace(settings, steps=steps)
