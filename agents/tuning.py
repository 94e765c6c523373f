"""Tuning: gains of a PD controller for the arm of an environment, by a random search."""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.control.pd import PD

SAMPLING = 0.95  # of 2 rotor inertia / period, from which on a sampled motor is unstable


@dataclass(frozen=True)
class Tuned:
    """Gains (n,) in N m/rad and N m s/rad, and the mean reward of an episode with them."""

    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    reward: float


def tune(name: str, first: int = 200, around: int = 60, episodes: int = 8, seed: int = 0) -> Tuned:
    """Finds gains for a named environment: the best of some drawn at random, then of some around that.

    All candidates act side by side on the same episodes. Stiffness is drawn between 0.02 and 5 torque limits a radian,
    damping between 0.02 and 0.95 of where a sampled motor turns unstable, both evenly on a logarithmic scale.
    """
    random, env = np.random.default_rng(seed), gym.make(name).unwrapped
    limits, model = env.torque_limit, env.simulator.model  # type: ignore[attr-defined]
    most = SAMPLING * 2.0 * model.constants.rotor_inertia / env.simulator.control_period  # type: ignore[attr-defined]
    low = np.log(np.concatenate([0.02 * limits, 0.02 * most]))
    high = np.log(np.concatenate([5.0 * limits, most]))
    gains = np.exp(random.uniform(low, high, (first, len(low))))
    rewards = _rewards(name, gains, episodes)
    best = np.log(gains[np.argmax(rewards)])
    near = np.exp(np.clip(best + 0.15 * random.standard_normal((around, len(low))), low, high))
    gains, rewards = np.vstack([gains, near]), np.append(rewards, _rewards(name, near, episodes))
    stiffness, damping = np.split(gains[np.argmax(rewards)], 2)
    return Tuned(tuple(stiffness.tolist()), tuple(damping.tolist()), float(rewards.max()))


def _rewards(name: str, gains: Array, episodes: int) -> Array:
    """Mean reward (c,) of the first episodes with each of the gains (c, 2 n)."""
    arms = len(gains) * episodes
    venv = gym.make_vec(name, arms, "vector_entry_point")
    inner = venv.unwrapped
    observations, infos = venv.reset(seed=np.tile(np.arange(episodes), len(gains)).tolist())
    stiffness, damping = np.split(np.repeat(gains, episodes, axis=0), 2, axis=1)
    n = stiffness.shape[1]
    held = inner.setup.pd(inner.batch.model)  # type: ignore[attr-defined]
    controller = PD([0.0] * n, [0.0] * n, held.torque_limit, held.gravity_model)
    controller.reset(np.arange(arms), infos["posture"], infos["posture"])
    controller.stiffness, controller.damping = stiffness, damping
    total, playing = np.zeros(arms), np.ones(arms, dtype=bool)  # next episodes do not count
    places = inner.sensors.slices  # type: ignore[attr-defined]
    while playing.any():
        actions = controller.act({name: observations[:, place] for name, place in places.items()})
        observations, rewards, terminated, truncated, _ = venv.step(actions)
        total += np.where(playing, rewards, 0.0)
        playing &= ~(terminated | truncated)
    return total.reshape(len(gains), episodes).mean(axis=1)
