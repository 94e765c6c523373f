"""Residual: an environment whose action is added to that of a PD controller."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from flexman_gym.control.pd import PD

# The best by mean reward of 8 episodes of FlexRRR-v0 among 200 gains drawn at random and 60 around the best of those,
# damping held below 950 N m s/rad: the sampled motor is unstable from 2 rotor inertia / period = 1000 on.
GAINS: dict[str, Any] = {"stiffness": (497.0, 325.0, 328.0), "damping": (950.0, 950.0, 103.0)}


def default_pd(env: Any) -> PD:
    """The PD controller of FlexRRR-v0 for that environment; raises ValueError for an arm without three joints."""
    joints = env.unwrapped.episodes.batch.model.n_joints
    if joints != len(GAINS["stiffness"]):
        raise ValueError(f"env: {joints} joints are not allowed; the PD gains are those of FlexRRR-v0, 3 joints")
    return PD(**GAINS, torque_limit=env.unwrapped.torque_limit)


class _Adding:
    """What both wrappers do: they keep the observation from which the PD controller computes its part of the action."""

    env: Any

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Starts an episode."""
        self._pd, self._slices = default_pd(self.env), self.env.unwrapped.sensors.slices
        self._observation, info = self.env.reset(**options)
        return self._observation, info

    def step(self, action: NDArray[np.floating]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Applies the sum of both actions."""
        total = np.clip(self._pd.act(self._observation, self._slices) + action, -1.0, 1.0)
        self._observation, *outcome = self.env.step(total.astype(np.float32))
        return self._observation, *outcome


class Residual(_Adding, gym.Wrapper[Any, Any, Any, Any]):
    """The sum of PD action and agent's action, saturated like a motor, drives the arm."""


class VectorResidual(_Adding, gym.vector.VectorWrapper):
    """The same for many arms; their environment resets in the step that ends an episode, or not by itself."""
