"""Training: PPO or SAC on an environment, with settings, checkpoints and normalisation kept in one folder."""

import json
import platform
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import stable_baselines3 as sb3
import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, EveryNTimesteps
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import flexman_gym  # noqa: F401  registers the environments
from flexman_agents.residual import Residual, VectorResidual
from flexman_agents.vector import Arms
from flexman_gym.checks import flag, one_of, store, text, whole_number

MODEL, STATISTICS, SETTINGS, REPLAY = "model.zip", "normalisation.pkl", "settings.json", "replay.pkl"

HYPERPARAMETERS: dict[str, dict[str, Any]] = {
    # one batch a large part of the rollout: with small ones the optimiser, not the simulator, takes the time
    "ppo": {
        "n_steps": 128,
        "batch_size": 1024,
        "n_epochs": 5,
        "learning_rate": 2e-4,
        # a vibration outlives the 100 steps that 0.99 looks ahead: with that, PPO spoils the PD it adds to
        "gamma": 0.999,
        "gae_lambda": 0.99,
        "policy_kwargs": {"net_arch": [128, 128], "log_std_init": -3.0},  # louder noise shakes the arm for seconds
    },
    "sac": {"batch_size": 256, "gamma": 0.99, "learning_starts": 2000, "policy_kwargs": {"net_arch": [128, 128]}},
}
ENVS = {"ppo": 64, "sac": 16}  # which learns once a step of all
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": sb3.PPO, "sac": sb3.SAC}


@dataclass(frozen=True)
class Settings:
    """What a training run needs to be repeated.

    Attributes:
        algo: "ppo" or "sac".
        env: id of the environment.
        steps: environment steps in all.
        seed: of environments, exploration and weights.
        envs: arms side by side; None takes 64 for PPO and 16 for SAC.
        residual: the policy adds to a PD controller instead of acting alone.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    algo: str = "ppo"
    env: str = "FlexRRR-v0"
    steps: int = 1_000_000
    seed: int = 0
    envs: int = None  # type: ignore[assignment]
    residual: bool = False

    def __post_init__(self) -> None:
        store(self, algo=one_of("algo", self.algo, ALGORITHMS))
        store(
            self,
            env=one_of("env", text("env", self.env), [name for name in gym.registry if name.startswith("Flex")]),
            steps=whole_number("steps", self.steps, 1, 10**10),
            seed=whole_number("seed", self.seed, 0, 2**32 - 1),
            envs=whole_number("envs", ENVS[self.algo] if self.envs is None else self.envs, 1, 4096),
            residual=flag("residual", self.residual),
        )


def make_env(settings: Settings, **keywords: Any) -> gym.Env[Any, Any]:
    """One environment of a run; keywords go to `gym.make`."""
    env = gym.make(settings.env, **keywords)
    return Residual(env) if settings.residual else env


def train(settings: Settings, folder: Path, checkpoint_every: int = 0, progress: bool = True) -> BaseAlgorithm:
    """Trains a policy from the start and saves it in a folder, every so many steps (0: only at the end).

    Writes model.zip, normalisation.pkl (the statistics of VecNormalize) and settings.json (with versions).

    Raises:
        ValueError: when the folder holds a run already.
    """
    if (folder / SETTINGS).exists():
        raise ValueError(f"folder: {folder} is not allowed; give a new one, or resume the run in it")
    torch.set_num_threads(1)  # two threads on two cores are many times slower for networks of this size
    folder.mkdir(parents=True, exist_ok=True)
    versions = {name: version(name) for name in ("flexman_gym", "gymnasium", "numba", "stable-baselines3", "torch")}
    chosen = dict(HYPERPARAMETERS[settings.algo])
    if settings.algo == "ppo":
        chosen["batch_size"] = min(chosen["batch_size"], chosen["n_steps"] * settings.envs)
    record = asdict(settings) | {"hyperparameters": chosen}
    record |= {"versions": versions | {"python": platform.python_version()}}
    (folder / SETTINGS).write_text(json.dumps(record, indent=1) + "\n")
    env = VecNormalize(_environments(settings), gamma=chosen["gamma"])
    model = ALGORITHMS[settings.algo]("MlpPolicy", env, seed=settings.seed, device="cpu", **chosen)
    return _learn(model, settings.steps, folder, checkpoint_every, progress)


def resume(folder: Path, steps: int, checkpoint_every: int = 0, progress: bool = True) -> BaseAlgorithm:
    """Goes on with the run in a folder, for more steps, from its newest model and statistics.

    Raises:
        FileNotFoundError: when there is no run.
    """
    torch.set_num_threads(1)
    settings = replace(load_settings(folder), steps=whole_number("steps", steps, 1, 10**10))
    env = VecNormalize.load(str(existing(folder / STATISTICS)), _environments(settings))
    model = ALGORITHMS[settings.algo].load(existing(folder / MODEL), env=env, device="cpu")
    if isinstance(model, OffPolicyAlgorithm):
        model.load_replay_buffer(existing(folder / REPLAY))
    # the same seed would draw the episodes of the first part again
    model.set_random_seed(settings.seed + model.num_timesteps)
    return _learn(model, settings.steps, folder, checkpoint_every, progress)


def load_settings(folder: Path) -> Settings:
    """The settings of the run in a folder; raises FileNotFoundError or ValueError with one clear line."""
    path = existing(folder / SETTINGS)
    try:
        record = json.loads(path.read_text())
        return Settings(**{name: record[name] for name in Settings.__dataclass_fields__})
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error} is not allowed; give the settings of a training run") from None


def existing(path: Path) -> Path:
    """The path when there is a file; raises FileNotFoundError with one clear line."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; give a folder that a training run has written")
    return path


def _environments(settings: Settings) -> VecMonitor:
    env = gym.make_vec(settings.env, settings.envs, "vector_entry_point", autoreset_mode=AutoresetMode.SAME_STEP)
    return VecMonitor(Arms(VectorResidual(env) if settings.residual else env))


class _SaveRun(BaseCallback):
    """Saves model and statistics under their plain names, so that a run that is cut off can be resumed."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder

    def _on_step(self) -> bool:
        return save(self.model, self._folder)


def save(model: BaseAlgorithm, folder: Path) -> bool:
    """Writes model, normalisation statistics and, for SAC, the replay buffer; returns True."""
    model.save(folder / MODEL)
    if isinstance(model, OffPolicyAlgorithm):
        model.save_replay_buffer(folder / REPLAY)
    statistics = model.get_vec_normalize_env()
    if statistics is not None:
        statistics.save(str(folder / STATISTICS))
    return True


def _learn(model: BaseAlgorithm, steps: int, folder: Path, checkpoint_every: int, progress: bool) -> BaseAlgorithm:
    callbacks: list[BaseCallback] = []
    if checkpoint_every:
        callbacks.append(EveryNTimesteps(checkpoint_every, _SaveRun(folder)))
    model.learn(steps, callback=callbacks, progress_bar=progress, reset_num_timesteps=False)
    save(model, folder)
    model.get_env().close()  # type: ignore[union-attr]
    return model
