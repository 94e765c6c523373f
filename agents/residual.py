"""Residual: an environment whose action is added to that of a PD controller."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray


def readings(env: Any, observation: NDArray[np.floating]) -> dict[str, NDArray[np.floating]]:
    """What the sensors of an environment read, by name, from its observations (size,) or (b, size)."""
    return {name: observation[..., place] for name, place in env.unwrapped.sensors.slices.items()}


class _Adding:
    """What both wrappers do: they keep the observation from which the PD controller computes its part of the action."""

    env: Any

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Starts an episode."""
        self._pd = self.env.unwrapped.setup.pd
        self._observation, info = self.env.reset(**options)
        return self._observation, info

    def step(self, action: NDArray[np.floating]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Applies the sum of both actions."""
        total = np.clip(self._pd.act(readings(self.env, self._observation)) + action, -1.0, 1.0)
        self._observation, *outcome = self.env.step(total.astype(np.float32))
        return self._observation, *outcome


class Residual(_Adding, gym.Wrapper[Any, Any, Any, Any]):
    """The sum of PD action and agent's action, saturated like a motor, drives the arm."""


class VectorResidual(_Adding, gym.vector.VectorWrapper):
    """The same for many arms; their environment resets in the step that ends an episode, or not by itself."""
