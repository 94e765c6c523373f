"""Training: PPO or SAC on an environment, with settings, checkpoints and normalisation kept in one folder."""

import json
import platform
from dataclasses import replace
from importlib.metadata import version
from inspect import signature
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

try:
    import stable_baselines3 as sb3
except ImportError as _error:
    raise ImportError("training needs Stable-Baselines3: pip install 'flexman_gym[train]'") from _error
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, EveryNTimesteps
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from flexman_agents.callbacks import Exploration, Judge, Saves, writers
from flexman_agents.policies import Act
from flexman_agents.seeds import training_seed
from flexman_agents.settings import EXPLORATION, HYPERPARAMETERS, Settings
from flexman_agents.vector import Arms
from flexman_gym.checks import one_of, refusal, whole_number

MODEL, STATISTICS, SETTINGS, REPLAY, BEST = "model.zip", "normalisation.pkl", "settings.json", "replay.pkl", "best"
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": sb3.PPO, "sac": sb3.SAC}
NET_ARCH, LOG_STD = [128, 128], {"ppo": -3.0, "sac": -3.0}  # louder noise shakes the arm for seconds


def train(
    settings: Settings,
    folder: Path,
    checkpoint_every: int = 0,
    progress: bool = True,
    device: str = "cpu",
) -> BaseAlgorithm:
    """Trains a policy from the start and saves it in a folder.

    Args:
        settings: what the run is.
        folder: for model.zip, normalisation.pkl (statistics of VecNormalize), settings.json (with versions), the curves
            in progress.csv and as TensorBoard events, and best/, the best policy on the way.
        checkpoint_every: steps between checkpoints; 0: only at the end.
        progress: show a bar.
        device: of the networks, as PyTorch names it.

    Raises:
        ValueError: when the folder holds a run already.
    """
    if (folder / SETTINGS).exists():
        raise ValueError(f"folder: {folder} is not allowed; give a new one, or resume the run in it")
    torch.set_num_threads(1)  # two threads on two cores are many times slower for networks of this size
    chosen = hyperparameters(settings)
    env = VecNormalize(_environments(settings), norm_reward=settings.normalise_reward, gamma=chosen["gamma"])
    model = ALGORITHMS[settings.algo]("MlpPolicy", env, seed=settings.seed, device=device, **chosen)
    env.seed(training_seed(settings.seed))
    folder.mkdir(parents=True, exist_ok=True)
    versions = {name: version(name) for name in ("flexman_gym", "gymnasium", "numba", "stable-baselines3", "torch")}
    record = settings.plain() | {"versions": versions | {"python": platform.python_version()}}
    (folder / SETTINGS).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return _learn(model, settings, folder, checkpoint_every, progress)


def resume(
    folder: Path,
    steps: int,
    checkpoint_every: int = 0,
    progress: bool = True,
    device: str = "cpu",
    judge_every: int | None = None,
) -> BaseAlgorithm:
    """Goes on with the run in a folder, for more steps, from its newest model and statistics.

    Its curves are in progress-STEPS.csv, after so many steps. It is judged as often as before where nothing else is
    said.

    Raises:
        FileNotFoundError: when there is no run.
        ValueError: when the run keeps its best policy, which is what acts, and would not be judged any more.
    """
    torch.set_num_threads(1)
    settings = replace(load_settings(folder), steps=whole_number("steps", steps, 1, 10**10))
    if judge_every is not None:
        settings = replace(settings, judge_every=judge_every)
    if (folder / BEST).is_dir() and not settings.judge_every:
        allowed = f"the steps between evaluations, > 0: {folder} keeps its best policy"
        raise refusal("judge_every", settings.judge_every, allowed)
    env = VecNormalize.load(str(existing(folder / STATISTICS)), _environments(settings))
    model = ALGORITHMS[settings.algo].load(existing(folder / MODEL), env=env, device=device)
    if isinstance(model, OffPolicyAlgorithm):
        model.load_replay_buffer(existing(folder / REPLAY))
    # the same seed would draw the episodes of the first part again
    model.set_random_seed(settings.seed + model.num_timesteps)
    env.seed(training_seed(settings.seed) + model.num_timesteps)
    return _learn(model, settings, folder, checkpoint_every, progress)


def hyperparameters(settings: Settings) -> dict[str, Any]:
    """Gives the arguments of the algorithm: defaults, what the settings say, and schedules.

    Raises:
        ValueError: for a name that the algorithm does not know.
    """
    chosen = HYPERPARAMETERS[settings.algo] | dict(settings.hyperparameters)
    policy = {"net_arch": chosen.pop("net_arch", NET_ARCH)}
    policy["log_std_init"] = chosen.pop("log_std_init", LOG_STD[settings.algo])
    if "activation" in chosen:
        policy["activation_fn"] = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[chosen.pop("activation")]
    rate = settings.schedule("learning_rate")
    if rate is not None:
        chosen["learning_rate"] = rate
    chosen.setdefault("learning_rate", 2e-4 if settings.algo == "ppo" else 3e-4)
    known = set(signature(ALGORITHMS[settings.algo].__init__).parameters) - {"self", "policy", "env", "policy_kwargs"}
    for name in chosen:
        one_of("hyperparameters", name, sorted(known | {"net_arch", "log_std_init", "activation"}))
    if settings.algo == "ppo":
        chosen["batch_size"] = min(chosen["batch_size"], chosen["n_steps"] * settings.envs)
    return chosen | {"policy_kwargs": policy}


def load_settings(folder: Path) -> Settings:
    """Reads the settings of the run in a folder.

    Raises:
        FileNotFoundError, ValueError: one clear line.
    """
    path = existing(folder / SETTINGS)
    return Settings.from_json(path, path.read_text(encoding="utf-8"))


def load_policy(folder: Path) -> tuple[Settings, Act]:
    """Loads the policy of a run: its best one where there is one, else its newest.

    Raises:
        FileNotFoundError, ValueError: one clear line.
    """
    torch.set_num_threads(1)
    settings = load_settings(folder)
    place = folder / BEST if (folder / BEST / MODEL).is_file() else folder
    model_path, statistics_path = existing(place / MODEL), existing(place / STATISTICS)
    model = ALGORITHMS[settings.algo].load(model_path, device="cpu")
    statistics = VecNormalize.load(str(statistics_path), _environments(replace(settings, envs=1)))
    return settings, acting(model, statistics)


def acting(model: BaseAlgorithm, statistics: VecNormalize) -> Act:
    """Gives the function that acts as a model does, without noise."""

    def act(observations: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.floating]:
        actions, _ = model.predict(statistics.normalize_obs(observations), deterministic=True)
        return np.asarray(actions, dtype=np.float32).reshape(shape)

    return act


def existing(path: Path) -> Path:
    """Gives the path when there is a file.

    Raises:
        FileNotFoundError: one clear line.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; give a folder that a training run has written")
    return path


def save(model: BaseAlgorithm, folder: Path) -> bool:
    """Writes model, normalisation statistics and, for SAC, the replay buffer; returns True."""
    folder.mkdir(parents=True, exist_ok=True)
    model.save(folder / MODEL)
    if isinstance(model, OffPolicyAlgorithm) and folder.name != BEST:
        model.save_replay_buffer(folder / REPLAY)
    statistics = model.get_vec_normalize_env()
    if statistics is not None:
        statistics.save(str(folder / STATISTICS))
    return True


def _environments(settings: Settings) -> VecMonitor:
    described = settings.description
    keywords = described.keywords() | {"autoreset_mode": AutoresetMode.SAME_STEP}
    return VecMonitor(Arms(gym.make_vec(described.id, settings.envs, "vector_entry_point", **keywords)))


def _learn(
    model: BaseAlgorithm, settings: Settings, folder: Path, checkpoint_every: int, progress: bool
) -> BaseAlgorithm:
    callbacks: list[BaseCallback] = []
    for exploration in filter(None, map(settings.schedule, EXPLORATION)):
        callbacks.append(Exploration(exploration, settings.steps))
    if settings.judge_every:
        statistics = model.get_vec_normalize_env()
        assert statistics is not None
        best = load_policy(folder)[1] if (folder / BEST).is_dir() else None
        act = acting(model, statistics)
        callbacks.append(Judge(settings, act, lambda: save(model, folder / BEST), best))
    if checkpoint_every:
        callbacks.append(EveryNTimesteps(checkpoint_every, Saves(lambda: save(model, folder))))
    model.set_logger(writers(folder, model.num_timesteps))
    # SAC logs after so many episodes, which end together
    told: dict[str, Any] = {"progress_bar": progress, "reset_num_timesteps": False}
    if isinstance(model, OffPolicyAlgorithm):
        told["log_interval"] = settings.envs
    model.learn(settings.steps, callback=callbacks, **told)
    save(model, folder)
    model.get_env().close()  # type: ignore[union-attr]
    return model
