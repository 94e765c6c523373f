"""Residual: an environment whose action is added to that of a PD controller."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from flexman_gym.control import PD

# Best of 260 gains drawn at random, by the mean return of 8 episodes of FlexRRR-v0 (limit of the sampled motor: 1000).
GAINS: dict[str, Any] = {"stiffness": (811.0, 369.0, 2972.0), "damping": (854.0, 384.0, 349.0)}


def default_pd(env: gym.Env[Any, Any]) -> PD:
    """The PD controller of FlexRRR-v0 for that environment; raises ValueError for an arm without three joints."""
    joints = env.unwrapped.simulator.model.n_joints  # type: ignore[attr-defined]
    if joints != len(GAINS["stiffness"]):
        raise ValueError(f"env: {joints} joints are not allowed; the PD gains are those of FlexRRR-v0, 3 joints")
    return PD(**GAINS, torque_limit=env.unwrapped.torque_limit)  # type: ignore[attr-defined]


class Residual(gym.Wrapper[Any, Any, Any, Any]):
    """The sum of PD action and agent's action, saturated like a motor, drives the arm."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self._pd = default_pd(env)
        self._slices = env.unwrapped.sensors.slices  # type: ignore[attr-defined]

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Starts an episode."""
        self._observation, info = self.env.reset(**options)
        return self._observation, info

    def step(self, action: NDArray[np.floating]) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Applies the sum of both actions."""
        total = np.clip(self._pd.act(self._observation, self._slices) + action, -1.0, 1.0)
        self._observation, reward, terminated, truncated, info = self.env.step(total.astype(np.float32))
        return self._observation, reward, terminated, truncated, info
