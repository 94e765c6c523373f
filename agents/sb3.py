"""Stable-Baselines3: models from settings, and policies from its files."""

import pickle
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Any

import gymnasium as gym
import stable_baselines3 as sb3
import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from flexman_agents.generalist import arm_environments
from flexman_agents.settings import DEFAULT_HYPERPARAMETERS, Settings
from flexman_agents.vector import JoinedVecEnv, SB3VecEnv
from flexman_gym.common import files
from flexman_gym.common.checks import one_of
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import existing_file
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.rollouts import training_seed

ACTIVATION_LAYERS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}  # name in settings.ACTIVATIONS -> layer
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": sb3.PPO, "sac": sb3.SAC}
DEFAULT_NET_ARCH = [128, 128]  # units of the hidden layers
DEFAULT_LOG_STD = {"ppo": -3.0, "sac": -3.0}  # larger noise excites vibrations that last for seconds


def make_model(settings: Settings, device: str = "cpu") -> BaseAlgorithm:
    """Make the model of a run and its environments, seeded by the settings.

    Args:
        settings: settings of the run.
        device: PyTorch device of the networks, such as "cpu".
    """
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        allowed = f"a device that PyTorch finds on this computer, such as cpu ({str(error).splitlines()[0]})"
        raise value_error("device", device, allowed) from None
    torch.set_num_threads(1)  # for networks of this size, two threads are many times slower than one
    chosen = _algorithm_arguments(settings)
    env = VecNormalize(_make_environments(settings), norm_reward=settings.normalise_reward, gamma=chosen["gamma"])
    model = ALGORITHMS[settings.algo]("MlpPolicy", env, seed=settings.seed, device=device, **chosen)
    if chosen["policy_kwargs"].get("ortho_init") is False:  # else Stable-Baselines3 starts with large actions, not zero
        for values in model.policy.action_net.parameters():  # type: ignore[union-attr]
            torch.nn.init.zeros_(values)
    env.seed(training_seed(settings.seed))
    return model


def _make_environments(settings: Settings) -> VecMonitor:
    """Return the vector environment of a training, with a monitor of returns and lengths of episodes."""
    if settings.arms is None:
        return VecMonitor(_make_vector(settings.training_environment, settings.envs))
    each_arm = settings.envs // settings.arms
    parts = [_make_vector(each, each_arm) for each in arm_environments(settings.environment, settings.arms)]
    return VecMonitor(JoinedVecEnv(parts))


def _make_vector(environment: Configuration, envs: int) -> SB3VecEnv:
    """Return the vector environment of one arm."""
    keywords = environment.keywords() | {"autoreset_mode": AutoresetMode.SAME_STEP, "infos": "at end"}
    return SB3VecEnv(gym.make_vec(environment.id, envs, "vector_entry_point", **keywords))


def _algorithm_arguments(settings: Settings) -> dict[str, Any]:
    """Return the keyword arguments of an algorithm: defaults, the hyperparameters of the settings, and schedules."""
    arguments = DEFAULT_HYPERPARAMETERS[settings.algo] | dict(settings.hyperparameters)
    policy_arguments = {"net_arch": arguments.pop("net_arch", DEFAULT_NET_ARCH)}
    policy_arguments["log_std_init"] = arguments.pop("log_std_init", DEFAULT_LOG_STD[settings.algo])
    if "ortho_init" in arguments:
        policy_arguments["ortho_init"] = arguments.pop("ortho_init")
    if "activation" in arguments:
        policy_arguments["activation_fn"] = ACTIVATION_LAYERS[arguments.pop("activation")]
    rate = settings.schedule("learning_rate")
    if rate is not None:
        arguments["learning_rate"] = rate
    arguments.setdefault("learning_rate", 2e-4 if settings.algo == "ppo" else 3e-4)
    known = set(signature(ALGORITHMS[settings.algo].__init__).parameters) - {"self", "policy", "env", "policy_kwargs"}
    for name in arguments:
        one_of("hyperparameters", name, sorted(known | {"net_arch", "log_std_init", "ortho_init", "activation"}))
    if settings.algo == "ppo":
        arguments["batch_size"] = min(arguments["batch_size"], arguments["n_steps"] * settings.envs)
    return arguments | {"policy_kwargs": policy_arguments}


# Class of the policy in a zip -> algorithm; the zip does not name the algorithm.
POLICY_CLASSES: dict[str, type[BaseAlgorithm]] = {"ActorCriticPolicy": PPO, "SACPolicy": SAC, "TD3Policy": TD3}
LOADING_ERRORS = (*files.READ_ERRORS, RuntimeError, AssertionError, ImportError, pickle.UnpicklingError)


def load_sb3(path: Path, environment: Configuration | None = None) -> AgentSpec:
    """Load a policy from a zip that a model of Stable-Baselines3 has written with `save`.

    Its normalisation (VecNormalize) is read from the file of the same name with the suffix .pkl, if it exists. Both
    files are pickles, which can run any code: load files from trusted sources only.

    Args:
        path: path of the zip.
        environment: environment in which the policy was trained, with the settings of its agent; None if it is the
            environment of the evaluation.

    Raises:
        FileNotFoundError: if the zip is missing.
        ValueError: for files that are not of Stable-Baselines3.
    """
    with files.reading(path, "is not a policy of Stable-Baselines3", LOADING_ERRORS):
        return _load_zip(path, environment)


def _load_zip(path: Path, environment: Configuration | None) -> AgentSpec:
    statistics = existing_file(path).with_suffix(".pkl")
    kind = load_from_zip_file(path)[0]["policy_class"].__name__  # type: ignore[index]
    model: BaseAlgorithm = POLICY_CLASSES[one_of("policy", kind, POLICY_CLASSES)].load(path, device="cpu")
    agent = AgentSpec.from_predictor(model, environment)
    if not statistics.is_file():
        return replace(agent, name=path.stem)
    with statistics.open("rb") as file:
        normaliser = pickle.load(file)
    law: Any = agent.law
    return replace(agent, name=path.stem, law=lambda observations: law(normaliser.normalize_obs(observations)))
