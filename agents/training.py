"""Training in a run folder, saved with its complete state for exact resumption."""

import random
import sys
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from flexman_agents.callbacks import (
    Evaluation,
    Exploration,
    Hook,
    Interrupted,
    ProgressLines,
    TrainingReport,
    ValueWarmup,
    open_logger,
    stop_on_interrupt,
)
from flexman_agents.imitation import DAggerRun
from flexman_agents.sb3 import make_model
from flexman_agents.settings import EXPLORATION_SCHEDULES, MAX_STEPS, Settings
from flexman_agents.vector import JoinedVecEnv, SB3VecEnv
from flexman_gym.common.checks import whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import reading
from flexman_gym.common.run_folder import (
    BEST,
    NEWEST,
    RESULT,
    SETTINGS,
    lock_folder,
    read_npz,
    read_settings,
    write_npz,
)
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.trained_agents import check_settings

# Names of attributes of Stable-Baselines3 models, wrappers and buffers that form the state of a training.
COUNTERS = ("num_timesteps", "_n_updates", "_episode_num", "_current_progress_remaining")
LAST_FIELDS = ("_last_obs", "_last_original_obs", "_last_episode_starts")
NORMALISER_FIELDS = ("old_obs", "old_reward")
MONITOR_FIELDS = ("episode_returns", "episode_lengths", "episode_count")
REPLAY_FIELDS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
STATISTICS_FIELDS = ("mean", "var", "count")
NO_STATE = "has no state of a run"  # predicate of a damaged file


def policy_state(model: BaseAlgorithm) -> dict[str, Any]:
    """Return the policy: parameters of the networks, and the statistics that normalise the observations."""
    return {
        "policy": _tensor_state(model.policy.state_dict()),
        "statistics": _statistics_state(_normaliser(model).obs_rms),
    }


def _set_policy_state(model: BaseAlgorithm, data: Any) -> None:
    """Restore the policy of a model with the same networks and observations."""
    _check(data, ("policy", "statistics"))
    model.policy.load_state_dict(_load_tensors("policy", model.policy.state_dict(), data["policy"]))
    _set_statistics("statistics", _normaliser(model).obs_rms, data["statistics"])


def _training_state(model: BaseAlgorithm) -> dict[str, Any]:
    """Return the state of a training at the beginning of a rollout, without the policy."""
    result: dict[str, Any] = {
        part: {name: get_state(getattr(owner, name)) for name in names}
        for part, (owner, names) in _attributes(model).items()
    }
    result |= {
        "optimizers": {  # states by parameter; hyperparameters belong to the model
            name: {str(key): _tensor_state(each) for key, each in optimizer.state_dict()["state"].items()}
            for name, optimizer in _optimizers(model).items()
        },
        "episodes": [[float(each[key]) for key in "rlt"] for each in model.ep_info_buffer or ()],
        "random": _random_state(),
    }
    normaliser, _, arms = _layers(model)
    result["returns"] = {"statistics": _statistics_state(normaliser.ret_rms), "running": normaliser.returns.copy()}
    result["environment"] = arms.get_state()
    if isinstance(model, OffPolicyAlgorithm):
        coefficient = model.log_ent_coef  # type: ignore[attr-defined]
        result["entropy"] = None if coefficient is None else coefficient.detach().numpy().copy()
        result["replay"] = _replay_state(model)
    return result


def _set_training_state(model: BaseAlgorithm, data: Any) -> None:
    """Restore the state of a training in a model made from the same settings."""
    attributes, (normaliser, _, arms) = _attributes(model), _layers(model)
    names = [*attributes, "optimizers", "episodes", "random", "returns", "environment"]
    _check(data, names + ["entropy", "replay"] * isinstance(model, OffPolicyAlgorithm))
    for part, (_, fields) in attributes.items():
        _check(data[part], fields, part)
    arms.set_state(data["environment"])
    for part, (owner, fields) in attributes.items():
        for name in fields:
            setattr(owner, name, get_state(data[part][name]))
    for name, optimizer in _optimizers(model).items():
        _set_optimizer_state(name, optimizer, data["optimizers"].get(name))
    episodes = [dict(zip("rlt", each, strict=True)) for each in data["episodes"]]
    model.ep_info_buffer = deque(episodes, maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)  # the tasks report no success
    _set_statistics("returns", normaliser.ret_rms, data["returns"]["statistics"])
    set_state("returns", normaliser.returns, data["returns"]["running"])
    if isinstance(model, OffPolicyAlgorithm):
        coefficient = model.log_ent_coef  # type: ignore[attr-defined]
        if coefficient is not None:
            logarithm = coefficient.detach().numpy().copy()
            coefficient.data = torch.as_tensor(set_state("entropy", logarithm, data["entropy"]))
        _set_replay_state(model, data["replay"])
    _set_random_state(data["random"])


def _layers(model: BaseAlgorithm) -> tuple[VecNormalize, VecMonitor, SB3VecEnv | JoinedVecEnv]:
    """Return the wrappers of the environment: normalisation, monitor, and the vector environment."""
    normaliser = _normaliser(model)
    monitor: Any = normaliser.venv
    return normaliser, monitor, monitor.venv


def _normaliser(model: BaseAlgorithm) -> VecNormalize:
    result = model.get_vec_normalize_env()
    assert result is not None
    return result


def _attributes(model: BaseAlgorithm) -> dict[str, tuple[Any, Sequence[str]]]:
    """Return part of the state -> object, and the names of its attributes that form this part."""
    normaliser, monitor, _ = _layers(model)
    counters = [name for name in COUNTERS if hasattr(model, name)]
    return {
        "counts": (model, counters), "last": (model, LAST_FIELDS), "seen": (normaliser, NORMALISER_FIELDS),
        "monitor": (monitor, MONITOR_FIELDS),
    }  # fmt: skip


def _check(data: Any, names: Collection[str], field: str = "run") -> None:
    if not isinstance(data, dict) or not set(names) <= data.keys():
        result = sorted(data) if isinstance(data, dict) else type(data).__name__
        raise value_error(field, result, f"the state of a run, with {', '.join(names)}")


def _tensor_state(tensors: Any) -> dict[str, Any]:
    return {name: tensor.detach().cpu().numpy().copy() for name, tensor in tensors.items()}


def _load_tensors(field: str, like: Any, arrays: Any) -> dict[str, torch.Tensor]:
    if not isinstance(arrays, dict) or arrays.keys() != like.keys():
        raise value_error(field, sorted(arrays) if isinstance(arrays, dict) else arrays, f"arrays {', '.join(like)}")
    wanted = _tensor_state(like)
    return {name: torch.as_tensor(_finite(f"{field}.{name}", wanted[name], arrays[name])) for name in like}


def _finite(field: str, old: NDArray[Any], data: Any, least: float = -np.inf) -> Any:
    """Return data as an array of the shape and type of `old`, after a check for finite numbers >= `least`."""
    result = set_state(field, old, data)
    if not (np.isfinite(result) & (np.asarray(result) >= least)).all():
        allowed = "finite numbers" if least < 0.0 else "finite numbers >= 0"
        raise value_error(field, "another number", allowed)
    return result


def _statistics_state(moments: Any) -> dict[str, Any]:
    return {name: np.array(getattr(moments, name), dtype=np.float64) for name in STATISTICS_FIELDS}


def _set_statistics(field: str, moments: Any, data: Any) -> None:
    for name, value in _statistics_state(moments).items():
        given = data.get(name) if isinstance(data, dict) else None
        result = _finite(f"{field}.{name}", value, given, -np.inf if name == "mean" else 0.0)
        setattr(moments, name, result if result.ndim else result.item() if name == "count" else np.float64(result))


def _optimizers(model: Any) -> dict[str, torch.optim.Optimizer]:
    if not isinstance(model, OffPolicyAlgorithm):
        return {"policy": model.policy.optimizer}
    trained: Any = model
    result = {"actor": trained.actor.optimizer, "critic": trained.critic.optimizer}
    return result | ({"entropy": trained.ent_coef_optimizer} if trained.ent_coef_optimizer else {})


def _set_optimizer_state(field: str, optimizer: torch.optim.Optimizer, data: Any) -> None:
    plain = optimizer.state_dict()
    if not isinstance(data, dict) or not data.keys() <= {str(i) for i in plain["param_groups"][0]["params"]}:
        raise value_error(f"optimizers.{field}", data if data is None else sorted(data), "the state of the optimiser")
    state = {int(key): {name: torch.as_tensor(value) for name, value in each.items()} for key, each in data.items()}
    optimizer.load_state_dict({"state": state, "param_groups": plain["param_groups"]})


def _replay_state(model: OffPolicyAlgorithm) -> dict[str, Any]:
    buffer: Any = model.replay_buffer
    rows = buffer.buffer_size if buffer.full else buffer.pos
    return {"pos": int(buffer.pos), "full": bool(buffer.full)} | {
        name: getattr(buffer, name)[:rows] for name in REPLAY_FIELDS
    }


def _set_replay_state(model: OffPolicyAlgorithm, data: Any) -> None:
    buffer: Any = model.replay_buffer
    rows = buffer.buffer_size if data["full"] else data["pos"]
    for name in REPLAY_FIELDS:
        set_state(f"replay.{name}", getattr(buffer, name)[:rows], data[name])
    buffer.pos, buffer.full = data["pos"], data["full"]


def _random_state() -> dict[str, Any]:
    """Return the states of the global random generators of Python, NumPy and PyTorch."""
    version, words, gauss = random.getstate()
    kind, keys, *rest = np.random.get_state(legacy=True)  # noqa: NPY002, Stable-Baselines3 draws from it
    return {
        "python": [version, list(words), gauss],
        "numpy": [kind, np.asarray(keys), *(each if isinstance(each, str) else float(each) for each in rest)],
        "torch": torch.get_rng_state().numpy().copy(),
    }


def _set_random_state(data: dict[str, Any]) -> None:
    version, words, gauss = data["python"]
    random.setstate((version, tuple(words), gauss))
    kind, keys, position, has_gauss, cached = data["numpy"]
    np.random.set_state((kind, keys, int(position), int(has_gauss), cached))  # noqa: NPY002
    torch.set_rng_state(torch.as_tensor(data["torch"]))


def train(
    settings: Settings,
    folder: str | Path,
    checkpoint_every: int = 0,
    progress: bool = True,
    device: str = "cpu",
    hook: Hook | None = None,
) -> BaseAlgorithm | None:
    """Train a policy from scratch and save the run in a folder.

    The folder gets settings.json (settings and versions of packages), newest.npz (complete state of the run), best.npz
    (policy with the best evaluation, if `eval_every` is set), and the learning curves in progress.csv and as
    TensorBoard events. Imitation ("dagger") saves its policy only, at the end.

    Args:
        settings: settings of the run.
        folder: new folder for the run.
        checkpoint_every: environment steps between checkpoints; 0 for a checkpoint at the end only.
        progress: True to show a progress bar.
        device: PyTorch device of the networks, such as "cpu".
        hook: function of a `callbacks.TrainingReport`, called at the start of each rollout and at the end; the run is
            saved and stops when the function returns True.

    Returns:
        The model of Stable-Baselines3; None for imitation learning.

    Raises:
        ValueError: if the folder holds a run already, or another process trains in it.
        OSError: if the folder cannot be written.
        Interrupted: after Ctrl-C, once the run is saved.
    """
    folder = Path(folder)
    _check_new_folder(folder)
    checkpoint_every = whole_number("checkpoint_every", checkpoint_every, 0, MAX_STEPS)
    run = _new_run(settings, folder, device)
    folder.mkdir(parents=True, exist_ok=True)
    with lock_folder(folder):
        _check_new_folder(folder)  # another process may have trained there meanwhile
        settings.write(folder, 0)
        return run.learn(checkpoint_every, progress, hook)


def resume(
    folder: Path,
    steps: int | None = None,
    checkpoint_every: int = 0,
    progress: bool = True,
    device: str = "cpu",
    eval_every: int | None = None,
    hook: Hook | None = None,
) -> BaseAlgorithm | None:
    """Resume the run in a folder to the end of its steps, with the same results as a run without interruption.

    With `steps`, a finished run is followed by a further run, which starts from the policy, optimiser and replay buffer
    and restarts the schedules. Its learning curves go to progress-N.csv, where N is the number of earlier steps.

    Args:
        folder: folder of the run.
        steps: environment steps of a further run; None for an unfinished run.
        checkpoint_every: environment steps between checkpoints; 0 for a checkpoint at the end only.
        progress: True to show a progress bar.
        device: PyTorch device of the networks, such as "cpu".
        eval_every: environment steps between evaluations; None for the value in the settings of the run.
        hook: as in `train`.

    Returns:
        The model of Stable-Baselines3; None for imitation learning.

    Raises:
        FileNotFoundError: if there is no run in the folder.
        ValueError: if `steps` is given for an unfinished run, or missing for a finished run; for eval_every = 0 if the
            folder has a best policy, which would never be updated; and as in `train`.
        OSError, Interrupted: as in `train`.
    """
    checkpoint_every = whole_number("checkpoint_every", checkpoint_every, 0, MAX_STEPS)
    settings = Settings.load(folder)
    with lock_folder(folder):
        data = read_npz(folder / NEWEST) if (folder / NEWEST).is_file() else None
        if data is not None:
            check_settings(folder / NEWEST, data, read_settings(folder))
        done = 0 if data is None else _steps_done(folder / NEWEST, data)
        finished = data is not None and done >= settings.steps
        settings = _continued_settings(settings, folder, steps, done, finished)
        if eval_every is not None:
            settings = replace(settings, eval_every=eval_every)
        if (folder / BEST).is_file() and not settings.eval_every:
            allowed = f"the steps between evaluations, > 0: {folder} has a best policy"
            raise value_error("eval_every", settings.eval_every, allowed)
        run = _new_run(settings, folder, device)
        if data is None:
            print(f"Nothing was saved in {folder} yet: the run starts from scratch.", file=sys.stderr)
        else:
            run.set_state(data, finished)
        (folder / RESULT).unlink(missing_ok=True)  # the guard compares the policy of the continued run
        settings.write(folder, run.done)
        return run.learn(checkpoint_every, progress, hook)


def train_or_resume(cell: tuple[Settings, str, Mapping[str, Any]]) -> str:
    """Train a run, or resume it to its end if the folder contains it; a task for `parallel_map`.

    Args:
        cell: settings, path of the folder, and a mapping with the keyword arguments of `train` and `resume`.

    Returns:
        The folder.

    Raises:
        ValueError: if the folder holds a run with different settings, and as in `train`.
    """
    settings, folder, keywords = cell
    path = Path(folder)
    if not (path / SETTINGS).exists():
        train(settings, path, **keywords)
        return folder
    settings.check_run(path)
    if not (path / NEWEST).is_file() or _steps_done(path / NEWEST, read_npz(path / NEWEST)) < settings.steps:
        resume(path, **keywords)
    return folder


def _check_new_folder(folder: Path) -> None:
    """Raise ValueError if a folder holds a run already."""
    if (folder / SETTINGS).exists():
        raise ValueError(f"folder: {folder} is not allowed; give a new one, or resume the run in it")


def _new_run(settings: Settings, folder: Path, device: str) -> "_Run | DAggerRun":
    """Return a new run."""
    if settings.algo == "dagger":
        return DAggerRun(settings, folder)
    return _Run(make_model(settings, device), settings, folder)


class _Checkpoints(BaseCallback):
    """Checkpoints at the start of rollouts: periodically, and when a stop is requested, which ends the training.

    Args:
        every: environment steps between checkpoints; 0 for no periodic checkpoints.
        save: function that saves the run.
        stop_requested: function that returns True if the training is to stop.

    Attributes:
        stopped: environment steps after which the training was stopped; None if it was not stopped.
    """

    def __init__(self, every: int, save: Callable[[], None], stop_requested: Callable[[], bool]) -> None:
        super().__init__()
        self._every, self._save, self._stop_requested = every, save, stop_requested
        self.stopped: int | None = None

    def _on_training_start(self) -> None:
        self._next = self.num_timesteps + self._every

    def _on_rollout_start(self) -> None:
        if self._stop_requested():
            self._save()
            self.stopped = self.model.num_timesteps
        elif self._every and self.model.num_timesteps >= self._next:
            self._next = self.model.num_timesteps + self._every
            self._save()

    def _on_step(self) -> bool:
        return self.stopped is None


class _Run:
    """Training of a model of Stable-Baselines3 in a run folder."""

    def __init__(self, model: BaseAlgorithm, settings: Settings, folder: Path) -> None:
        self.model, self.settings, self.folder = model, settings, folder
        self._before = 0  # steps of the earlier runs in the folder
        self._evaluation: Evaluation | None = None
        if settings.eval_every:
            law = AgentSpec.from_predictor(model, settings.environment).law
            self._evaluation = Evaluation(settings, law, self._save_best)

    @property
    def done(self) -> int:
        """Environment steps so far, including steps of earlier runs in the folder."""
        return self._before + int(self.model.num_timesteps)

    def set_state(self, data: dict[str, Any], further: bool) -> None:
        """Restore the saved state.

        Args:
            data: content of the file with the state.
            further: True if the saved run is finished and a further run starts, which counts its steps from zero.
        """
        with reading(self.folder / NEWEST, NO_STATE):
            _set_policy_state(self.model, data)
            _set_training_state(self.model, data["training"])
            if self._evaluation and data["evaluation"] is not None:
                set_state("evaluation", self._evaluation, data["evaluation"])
            self._before = whole_number("before", data["before"], 0, MAX_STEPS)
        if further:
            count = self.model.num_timesteps
            print(
                f"The run of {count} steps was finished; a further run of {self.settings.steps} steps starts from it.",
                file=sys.stderr,
            )
            self._before += count
            self.model.num_timesteps, self.model._current_progress_remaining = 0, 1.0
            if self._evaluation:
                self._evaluation.begin()

    def learn(self, checkpoint_every: int, progress: bool, hook: Hook | None) -> BaseAlgorithm:
        """Train to the end of the steps, or until the hook or Ctrl-C stops the training."""
        model, settings = self.model, self.settings
        callbacks: list[BaseCallback] = []
        for exploration in filter(None, map(settings.schedule, EXPLORATION_SCHEDULES)):
            callbacks.append(Exploration(exploration, settings.steps))
        if settings.value_warmup:
            callbacks.append(ValueWarmup(settings.value_warmup))
        if self._evaluation:
            callbacks.append(self._evaluation)
        callbacks += [ProgressLines(settings.steps)] * (progress and not sys.stderr.isatty())
        keywords: dict[str, Any] = {"progress_bar": progress and sys.stderr.isatty(), "reset_num_timesteps": False}
        if isinstance(model, OffPolicyAlgorithm):
            keywords["log_interval"] = settings.envs  # in episodes; the episodes of all arms end together
        with stop_on_interrupt() as stop_requested:
            model.set_logger(open_logger(self.folder, self._before, model.num_timesteps))
            stop = (lambda: stop_requested.is_set() or bool(hook(self._report()))) if hook else stop_requested.is_set
            checkpoints = _Checkpoints(checkpoint_every, self._save, stop)
            model.learn(settings.steps - model.num_timesteps, callback=[checkpoints, *callbacks], **keywords)
        model.get_env().close()  # type: ignore[union-attr]
        if checkpoints.stopped is not None and stop_requested.is_set():
            raise Interrupted(f"{self.folder}: stopped after {checkpoints.stopped} steps; the run is saved")
        if checkpoints.stopped is None:
            self._save()
            if hook:
                hook(self._report())
        return model

    def _report(self) -> TrainingReport:
        return TrainingReport(self.done, dict(self._evaluation.latest) if self._evaluation else {}, self._save)

    def _save(self) -> None:
        evaluation = get_state(self._evaluation) if self._evaluation else None
        data = {"training": _training_state(self.model), "evaluation": evaluation, "before": self._before}
        write_npz(self.folder / NEWEST, self._policy() | data)

    def _save_best(self) -> None:
        write_npz(self.folder / BEST, self._policy())

    def _policy(self) -> dict[str, Any]:
        """Return the policy with the settings of its run."""
        return policy_state(self.model) | {"settings": self.settings.plain()}


def _steps_done(path: Path, data: Any) -> int:
    with reading(path, NO_STATE):
        return whole_number("num_timesteps", data["training"]["counts"]["num_timesteps"], 0, MAX_STEPS)


def _continued_settings(settings: Settings, folder: Path, steps: int | None, done: int, finished: bool) -> Settings:
    """Return the settings with which a run continues."""
    if finished and steps is None:
        raise ValueError(f"steps: None is not allowed; give the steps of a further run: that in {folder} is finished")
    if not finished and steps is not None:
        allowed = f"no steps: the run in {folder} has {done} of its {settings.steps} steps and continues to its end"
        raise value_error("steps", steps, allowed)
    return settings if steps is None else replace(settings, steps=steps)
