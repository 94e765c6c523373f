"""Clones whoever acted in a Minari dataset, as a run that can be evaluated: clone.py DATASET FOLDER [STEPS]"""

import json
import sys
from pathlib import Path

import minari
import numpy as np
import torch

from flexman_agents.sb3 import make_model
from flexman_agents.settings import Settings
from flexman_agents.training import policy_state
from flexman_gym.common.run_folder import NEWEST, SETTINGS, write_npz
from flexman_gym.agent.normalisation import RunningMeanStd

BATCH, RATE = 1024, 1e-3


def clone(dataset: str, folder: Path, steps: int = 5000) -> float:
    """Fits the network of a PPO policy to the actions of a dataset; gives the last mean squared error."""
    data = minari.load_dataset(dataset)
    spec = data.spec.env_spec
    environment = {"id": spec.id} | {name: value for name, value in spec.kwargs.items() if name != "name"}
    settings = Settings("ppo", environment, steps, envs=1, hyperparameters={"net_arch": [128, 128]})
    model = make_model(settings)
    episodes = list(data.iterate_episodes())
    observations = np.concatenate([each.observations[:-1] for each in episodes])
    actions = torch.from_numpy(np.concatenate([each.actions for each in episodes]))

    scales, statistics = RunningMeanStd(observations.shape[1:]), model.get_vec_normalize_env().obs_rms
    scales.add(observations)
    statistics.mean, statistics.var, statistics.count = scales.mean, scales.squares / scales.count, scales.count
    inputs, random = torch.from_numpy(scales.apply(observations)), torch.Generator().manual_seed(0)

    adam = torch.optim.Adam(model.policy.parameters(), RATE)
    for step in range(steps):
        adam.param_groups[0]["lr"] = RATE * (1.0 - step / steps)
        rows = torch.randint(len(inputs), (BATCH,), generator=random)
        loss = (model.policy.get_distribution(inputs[rows]).distribution.mean - actions[rows]).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    folder.mkdir(parents=True)
    write_npz(folder / NEWEST, policy_state(model) | {"settings": settings.plain()})
    (folder / SETTINGS).write_text(json.dumps(settings.plain()))
    return float(loss.detach())


if __name__ == "__main__":
    print(f"mean squared error {clone(sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:])):.2g}")
