"""Collects with TorchRL from the vector environment, by a policy of PyTorch: python docs/examples/collect.py"""

import time

import gymnasium as gym
import torch
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torchrl.collectors import Collector
from torchrl.envs.libs.gym import GymWrapper
from torchrl.modules import ProbabilisticActor, TanhNormal

import flexman_gym  # noqa: F401  registers the environments

ARMS, PERIODS, BATCHES = 256, 12, 20


def make() -> GymWrapper:
    """The vector environment as TorchRL takes it, which resets the arms that have ended by itself."""
    settings = {
        "base": "pd",
        "action_repeat": 5,
        "sensors": ("full", "fine"),
        "task": {"kind": "slew", "reward": "distance"},
    }
    return GymWrapper(gym.make_vec("FlexRRR-v0", ARMS, autoreset_mode="Disabled", **settings))


def actor(env: GymWrapper) -> ProbabilisticActor:
    """A policy of two layers with a normal distribution that ends at -1 and 1."""
    seen, actions = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    layers = torch.nn.Sequential(
        torch.nn.Linear(seen, 128), torch.nn.Tanh(), torch.nn.Linear(128, 128), torch.nn.Tanh(),
        torch.nn.Linear(128, 2 * actions), NormalParamExtractor(),
    )  # fmt: skip
    module = TensorDictModule(layers, in_keys=["observation"], out_keys=["loc", "scale"])
    return ProbabilisticActor(
        module, in_keys=["loc", "scale"], distribution_class=TanhNormal, return_log_prob=True, spec=env.action_spec
    )


def main() -> None:
    """Collects a few batches and says how fast."""
    torch.set_num_threads(1)
    env = make()
    env.set_seed(0)
    frames = ARMS * PERIODS
    collector = Collector(env, actor(env), frames_per_batch=frames, total_frames=BATCHES * frames)
    started, ended = time.process_time(), 0
    for batch in collector:
        ended += int(batch["next", "done"].sum())
    rate = BATCHES * frames / (time.process_time() - started)
    print(f"batch {tuple(batch.shape)}, {ended} episodes ended, {rate:.0f} decisions a CPU second")
    collector.shutdown()


if __name__ == "__main__":
    main()
