"""Algorithm: PPO or SAC of Stable-Baselines3, made from settings, on as many arms as they say."""

from inspect import signature
from typing import Any

import gymnasium as gym
import numpy as np
import stable_baselines3 as sb3
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from flexman_agents.settings import HYPERPARAMETERS, Settings
from flexman_agents.vector import Arms
from flexman_gym.checks import one_of, refusal
from flexman_gym.evaluation.entrants import Act
from flexman_gym.evaluation.seeds import training_seed

LAYERS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}  # by the names of settings.ACTIVATIONS
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": sb3.PPO, "sac": sb3.SAC}
NET_ARCH, LOG_STD = [128, 128], {"ppo": -3.0, "sac": -3.0}  # louder noise shakes the arm for seconds


def make_model(settings: Settings, device: str = "cpu") -> BaseAlgorithm:
    """Makes a new model with its arms, all seeded.

    Raises:
        ValueError: for a hyperparameter that the algorithm does not know, and a device that there is not.
    """
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise refusal(
            "device", device, f"one that PyTorch has here, such as cpu ({str(error).splitlines()[0]})"
        ) from None
    torch.set_num_threads(1)  # two threads on two cores are many times slower for networks of this size
    chosen = hyperparameters(settings)
    env = VecNormalize(environments(settings), norm_reward=settings.normalise_reward, gamma=chosen["gamma"])
    model = ALGORITHMS[settings.algo]("MlpPolicy", env, seed=settings.seed, device=device, **chosen)
    if chosen["policy_kwargs"].get("ortho_init") is False:  # else SB3 begins with actions next to zero
        for values in model.policy.action_net.parameters():  # type: ignore[union-attr]
            torch.nn.init.zeros_(values)
    env.seed(training_seed(settings.seed))
    return model


def environments(settings: Settings) -> VecMonitor:
    """Makes the arms of a training."""
    described = settings.description
    keywords = described.keywords() | {"autoreset_mode": AutoresetMode.SAME_STEP, "infos": "at end"}
    return VecMonitor(Arms(gym.make_vec(described.id, settings.envs, "vector_entry_point", **keywords)))


def hyperparameters(settings: Settings) -> dict[str, Any]:
    """Gives the arguments of the algorithm: defaults, what the settings say, and schedules.

    Raises:
        ValueError: for a name that the algorithm does not know.
    """
    chosen = HYPERPARAMETERS[settings.algo] | dict(settings.hyperparameters)
    policy = {"net_arch": chosen.pop("net_arch", NET_ARCH)}
    policy["log_std_init"] = chosen.pop("log_std_init", LOG_STD[settings.algo])
    if "ortho_init" in chosen:
        policy["ortho_init"] = chosen.pop("ortho_init")
    if "activation" in chosen:
        policy["activation_fn"] = LAYERS[chosen.pop("activation")]
    rate = settings.schedule("learning_rate")
    if rate is not None:
        chosen["learning_rate"] = rate
    chosen.setdefault("learning_rate", 2e-4 if settings.algo == "ppo" else 3e-4)
    known = set(signature(ALGORITHMS[settings.algo].__init__).parameters) - {"self", "policy", "env", "policy_kwargs"}
    for name in chosen:
        one_of("hyperparameters", name, sorted(known | {"net_arch", "log_std_init", "ortho_init", "activation"}))
    if settings.algo == "ppo":
        chosen["batch_size"] = min(chosen["batch_size"], chosen["n_steps"] * settings.envs)
    return chosen | {"policy_kwargs": policy}


def acting(model: BaseAlgorithm, statistics: VecNormalize) -> Act:
    """Gives the function that acts as a model does, without noise."""

    def act(observations: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.floating]:
        actions, _ = model.predict(statistics.normalize_obs(observations), deterministic=True)
        return np.asarray(actions, dtype=np.float32).reshape(shape)

    return act
