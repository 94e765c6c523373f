"""PPO of TorchRL in `GymEnv`, as in its tutorial."""

import torch
from report import ENVIRONMENT, SETTINGS, report
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.envs import GymEnv, RewardSum, StepCounter, TransformedEnv
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

FRAMES, BATCHES, EPOCHS, MINIBATCH = 1000, 20, 10, 64
torch.manual_seed(0)
torch.set_num_threads(1)
env = TransformedEnv(GymEnv(ENVIRONMENT, **SETTINGS), StepCounter())
env.append_transform(RewardSum())


def layers(outputs: int) -> nn.Sequential:
    """Return two hidden layers of 64 units."""
    return nn.Sequential(nn.LazyLinear(64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


size = env.action_spec.shape[-1]
module = TensorDictModule(
    nn.Sequential(layers(2 * size), NormalParamExtractor()), in_keys=["observation"], out_keys=["loc", "scale"]
)
policy = ProbabilisticActor(
    module=module, spec=env.action_spec, in_keys=["loc", "scale"], distribution_class=TanhNormal,
    distribution_kwargs={"low": env.action_spec.space.low, "high": env.action_spec.space.high}, return_log_prob=True,
)  # fmt: skip
value = ValueOperator(module=layers(1), in_keys=["observation"])
policy(env.reset())
value(env.reset())
advantage = GAE(gamma=0.99, lmbda=0.95, value_network=value, average_gae=True)
loss = ClipPPOLoss(actor_network=policy, critic_network=value, clip_epsilon=0.2)
optimizer = torch.optim.Adam(loss.parameters(), 3e-4)


def learn() -> None:
    """Collect batches and update the networks."""
    collector = Collector(env, policy, frames_per_batch=FRAMES, total_frames=BATCHES * FRAMES)
    buffer = ReplayBuffer(storage=LazyTensorStorage(max_size=FRAMES), sampler=SamplerWithoutReplacement())
    for data in collector:
        for _ in range(EPOCHS):
            with torch.no_grad():
                advantage(data)
            buffer.extend(data.reshape(-1))
            for _ in range(FRAMES // MINIBATCH):
                values = loss(buffer.sample(MINIBATCH))
                sum(values[name] for name in ("loss_objective", "loss_critic", "loss_entropy")).backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimizer.step()
                optimizer.zero_grad()
    collector.shutdown()


def act(observation):
    """Return the action at the mean of the normal distribution."""
    with torch.no_grad():
        return torch.tanh(module(torch.as_tensor(observation))[0]).numpy()


report("TorchRL PPO", act, learn)
