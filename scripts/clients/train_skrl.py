"""PPO of skrl in a vector environment; its Gaussian policy does not clip actions, so that the environment must."""

import gymnasium as gym
import torch
from report import ENVIRONMENT, SETTINGS, report
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed
from torch import nn

ARMS, ROLLOUT = 16, 128
set_seed(0)
env = wrap_env(gym.make_vec(ENVIRONMENT, ARMS, clip_actions=True, infos="flat", **SETTINGS))
spaces = {
    "observation_space": env.observation_space, "state_space": env.state_space, "action_space": env.action_space,
    "device": env.device,
}  # fmt: skip


def layers(outputs: int) -> nn.Sequential:
    """Return two hidden layers of 64 units."""
    inputs = env.observation_space.shape[0]
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


class Policy(GaussianMixin, Model):
    """Gaussian policy."""

    def __init__(self) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.net, self.log_std = layers(self.num_actions), nn.Parameter(torch.zeros(self.num_actions))

    def compute(self, inputs, role=""):
        """Return the mean actions and the logarithm of their standard deviations."""
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Value(DeterministicMixin, Model):
    """Value function."""

    def __init__(self) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = layers(1)

    def compute(self, inputs, role=""):
        """Return the values."""
        return self.net(inputs["observations"]), {}


cfg = PPO_CFG(
    rollouts=ROLLOUT, learning_epochs=10, mini_batches=32, learning_rate=3e-4,
    observation_preprocessor=RunningStandardScaler,
    observation_preprocessor_kwargs={"size": env.observation_space, "device": env.device},
    value_preprocessor=RunningStandardScaler, value_preprocessor_kwargs={"size": 1, "device": env.device},
)  # fmt: skip
cfg.experiment.write_interval = cfg.experiment.checkpoint_interval = 0
models = {"policy": Policy(), "value": Value()}
memory = RandomMemory(memory_size=ROLLOUT, num_envs=ARMS, device=env.device)
agent = PPO(models=models, memory=memory, cfg=cfg, **spaces)
trainer = SequentialTrainer(
    cfg={"timesteps": 12 * ROLLOUT, "headless": True, "disable_progressbar": True}, env=env, agents=agent
)


def act(observation):
    """Return the mean action."""
    with torch.no_grad():
        seen = torch.as_tensor(observation, dtype=torch.float32)[None]
        return models["policy"].net(agent._observation_preprocessor(seen))[0].numpy()


report("skrl PPO", act, trainer.train)
