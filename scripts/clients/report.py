"""Mean return of a policy before and after its training, the same for all clients."""

import sys
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

import flexman_gym  # noqa: F401  registers the environments

ENVIRONMENT, SETTINGS = "FlexOne-v0", {"action_repeat": 5}
EPISODES = 20  # number of episodes of an evaluation; their seeds begin at FIRST_SEED
FIRST_SEED = 9000


def mean_return(act: Callable[[Any], Any]) -> float:
    """Return the mean return of a policy, a function from an observation (size,) to an action (1,)."""
    env, returns = gym.make(ENVIRONMENT, clip_actions=True, **SETTINGS), np.zeros(EPISODES)
    for episode in range(EPISODES):
        observation, _ = env.reset(seed=FIRST_SEED + episode)
        ended = False
        while not ended:
            observation, reward, terminated, truncated, _ = env.step(np.asarray(act(observation), dtype=np.float32))
            returns[episode] += reward
            ended = terminated or truncated
    return float(returns.mean())


def report(client: str, act: Callable[[Any], Any], learn: Callable[[], object]) -> None:
    """Train, print the mean returns before and after, and exit with 1 if the training has not increased it."""
    before = mean_return(act)
    learn()
    after = mean_return(act)
    print(f"{client}: mean return {before:.1f} before, {after:.1f} after the training", flush=True)
    if not after > before:
        sys.exit(f"{client}: the training has not increased the return")
