"""Train PPO or SAC of Stable-Baselines3 on FlexRRR-v0 in minutes on one core: python scripts/train.py [ppo | sac]

Copy this file into your project and change it. It writes runs/ppo.zip or runs/sac.zip, which scripts/evaluate.py tests.
"""

import sys
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import flexman_gym  # noqa: F401  registers the environments
from flexman_agents.vector import SB3VecEnv

# The action is added to the torques of a PD controller and held for five control periods, 0.1 s. The reward "distance"
# still increases at errors of millimetres.
SETTINGS: dict[str, Any] = {"base": "pd", "action_repeat": 5, "reward": "distance"}
NETWORK = {"net_arch": [128, 128], "log_std_init": -1.6}  # little noise, as it excites vibrations that last for seconds
STEPS = {"ppo": 2_000_000, "sac": 600_000}  # three and six minutes of CPU time


def environment(arms: int) -> VecMonitor:
    """Return arms that one call simulates together, as a vector environment of Stable-Baselines3."""
    return VecMonitor(SB3VecEnv(gym.make_vec("FlexRRR-v0", arms, autoreset_mode="SameStep", **SETTINGS)))


def model(algorithm: str) -> PPO | SAC:
    """Return a new model of an algorithm."""
    if algorithm == "sac":
        return SAC("MlpPolicy", environment(256), learning_rate=1e-3, batch_size=1024, gamma=0.95, gradient_steps=8,
                   ent_coef="auto_0.02", learning_starts=4000, policy_kwargs=NETWORK, device="cpu", seed=0)  # fmt: skip
    arms = VecNormalize(environment(256), norm_obs=False, gamma=0.95)  # divides rewards by their standard deviation
    return PPO("MlpPolicy", arms, learning_rate=lambda left: 1e-3 * left, n_steps=12, batch_size=512, n_epochs=4,
               gamma=0.95, gae_lambda=0.9, policy_kwargs=NETWORK, device="cpu", seed=0)  # fmt: skip


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads do not speed up networks of this size
    name = sys.argv[1] if len(sys.argv) > 1 else "ppo"
    model(name).learn(int(sys.argv[2]) if len(sys.argv) > 2 else STEPS[name], progress_bar=False).save(f"runs/{name}")
