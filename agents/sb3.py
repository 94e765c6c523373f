"""Stable-Baselines3: models from settings, and policies from its files."""

import pickle
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from flexman_agents.generalist import arm_environments
from flexman_agents.settings import CONTRIB_ALGORITHMS, DEFAULT_HYPERPARAMETERS, Settings
from flexman_agents.vector import JoinedVecEnv, SB3VecEnv
from flexman_gym.common import files
from flexman_gym.common.checks import one_of
from flexman_gym.common.computer import optional_module
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import existing_file
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.rollouts import training_seed

ACTIVATION_LAYERS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}  # name in settings.ACTIVATIONS -> layer
DEFAULT_NET_ARCH = [128, 128]  # units of the hidden layers
DEFAULT_LOG_STD = -3.0  # larger noise excites vibrations that last for seconds
DEFAULT_RATES = {"ppo": 2e-4, "sac": 3e-4, "tqc": 3e-4, "crossq": 1e-3}  # algorithm -> learning rate
# algorithm -> hyperparameters that belong to its policy
POLICY_HYPERPARAMETERS: dict[str, tuple[str, ...]] = {
    "ppo": ("ortho_init",), "sac": ("n_critics",), "tqc": ("n_critics", "n_quantiles"), "crossq": ("n_critics",),
}  # fmt: skip
NO_HYPERPARAMETERS = {  # arguments of an algorithm that the settings, or the run, determine
    "self", "policy", "env", "policy_kwargs", "seed", "device", "tensorboard_log", "verbose", "_init_setup_model",
}  # fmt: skip
CRITIC_NORM = ("sac", "tqc")  # algorithms with the hyperparameter critic_norm


def algorithm_class(algo: str) -> type[BaseAlgorithm]:
    """Return the class of an algorithm of Stable-Baselines3: "ppo", "sac", "td3", "tqc" or "crossq".

    Raises:
        ImportError: for TQC and CrossQ without sb3-contrib.
    """
    own: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "td3": TD3}
    if algo not in CONTRIB_ALGORITHMS:
        return own[algo]
    contrib = optional_module("sb3_contrib", f"algo: {algo}", "train")
    result: type[BaseAlgorithm] = {"tqc": contrib.TQC, "crossq": contrib.CrossQ}[algo]
    return result


class _NormedCritics:
    """Layer normalisation before the activations of the critics, a part of a policy of SAC or TQC."""

    def make_critic(self, features_extractor: Any = None) -> Any:
        critic: Any = super().make_critic(features_extractor)  # type: ignore[misc]
        for network in critic.q_networks:
            hidden = [i for i, layer in enumerate(network[:-1]) if isinstance(layer, torch.nn.Linear)]
            for i in reversed(hidden):
                network.insert(i + 1, torch.nn.LayerNorm(network[i].out_features, device=critic.device))
        return critic


def _policy_class(algorithm: Any, normed: bool) -> type[BasePolicy]:
    """Return the class of the policies of an algorithm; with layer normalisation in the critics if `normed`."""
    plain: type[BasePolicy] = algorithm.policy_aliases["MlpPolicy"]
    # of the same name: a zip names it, and contains it
    return type(plain.__name__, (_NormedCritics, plain), {}) if normed else plain


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
    algorithm = algorithm_class(settings.algo)
    chosen = _algorithm_arguments(settings, algorithm)
    policy = _policy_class(algorithm, chosen.pop("critic_norm", False))
    env = VecNormalize(_make_environments(settings), norm_reward=settings.normalise_reward, gamma=chosen["gamma"])
    model = algorithm(policy, env, seed=settings.seed, device=device, **chosen)
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


def _algorithm_arguments(settings: Settings, algorithm: type[BaseAlgorithm]) -> dict[str, Any]:
    """Return the keyword arguments of an algorithm, and `critic_norm`: defaults, hyperparameters, and schedules."""
    algo = settings.algo
    arguments = DEFAULT_HYPERPARAMETERS[algo] | dict(settings.hyperparameters)
    own = {"net_arch": DEFAULT_NET_ARCH, "log_std_init": DEFAULT_LOG_STD}
    names = (*own, *POLICY_HYPERPARAMETERS[algo])
    policy_arguments = own | {name: arguments.pop(name) for name in names if name in arguments}
    if "activation" in arguments:
        policy_arguments["activation_fn"] = ACTIVATION_LAYERS[arguments.pop("activation")]
    rate = settings.schedule("learning_rate")
    if rate is not None:
        arguments["learning_rate"] = rate
    arguments.setdefault("learning_rate", DEFAULT_RATES[algo])
    known = set(signature(algorithm.__init__).parameters) - NO_HYPERPARAMETERS
    known |= {*names, "activation", *(["critic_norm"] if algo in CRITIC_NORM else [])}
    for name in arguments:
        one_of("hyperparameters", name, sorted(known))
    if algo == "ppo":
        arguments["batch_size"] = min(arguments["batch_size"], arguments["n_steps"] * settings.envs)
    return arguments | {"policy_kwargs": policy_arguments}


# Class of the policy in a zip -> algorithm; the zip does not name the algorithm.
POLICY_CLASSES = {"ActorCriticPolicy": "ppo", "SACPolicy": "sac", "TQCPolicy": "tqc", "CrossQPolicy": "crossq",
                  "TD3Policy": "td3"}  # fmt: skip
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
    model = algorithm_class(POLICY_CLASSES[one_of("policy", kind, POLICY_CLASSES)]).load(path, device="cpu")
    agent = AgentSpec.from_predictor(model, environment)
    if not statistics.is_file():
        return replace(agent, name=path.stem)
    with statistics.open("rb") as file:
        normaliser = pickle.load(file)
    law: Any = agent.law
    return replace(agent, name=path.stem, law=lambda observations: law(normaliser.normalize_obs(observations)))
