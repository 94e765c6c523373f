"""Tuning: gains of a PD controller for the arm of an environment, by a random search."""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.control.pd import PD, stability_limit
from flexman_gym.envs.description import Description

SAMPLING = 0.95  # of the damping from which on a sampled motor is unstable


@dataclass(frozen=True)
class Tuned:
    """Gains (n,) in N m/rad and N m s/rad, and the mean reward of an episode with them."""

    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    reward: float


def tune(environment: Description, first: int = 200, around: int = 60, episodes: int = 8, seed: int = 0) -> Tuned:
    """Finds gains for an environment: the best of some drawn at random, then of some around that.

    All candidates act side by side on the same episodes. Stiffness is drawn between 0.02 and 5 torque limits a radian,
    damping between 0.02 and 0.95 of where a sampled motor turns unstable with the largest delay of the environment,
    both evenly on a logarithmic scale.
    """
    random, setup = np.random.default_rng(seed), environment.setup()
    limits = np.array(setup.torque_limit)
    rotors = np.array([joint.rotor_inertia for joint in setup.arm.joints])
    delay = setup.disturbed.delay if setup.disturbed else None
    most = SAMPLING * stability_limit(int(delay[1]) if delay else 0) * rotors / setup.control_period
    low = np.log(np.concatenate([0.02 * limits, 0.02 * most]))
    high = np.log(np.concatenate([5.0 * limits, most]))
    gains = np.exp(random.uniform(low, high, (first, len(low))))
    rewards = _rewards(environment, gains, episodes)
    best = np.log(gains[np.argmax(rewards)])
    near = np.exp(np.clip(best + 0.15 * random.standard_normal((around, len(low))), low, high))
    gains, rewards = np.vstack([gains, near]), np.append(rewards, _rewards(environment, near, episodes))
    stiffness, damping = np.split(gains[np.argmax(rewards)], 2)
    return Tuned(tuple(stiffness.tolist()), tuple(damping.tolist()), float(rewards.max()))


def _rewards(environment: Description, gains: Array, episodes: int) -> Array:
    """Mean reward (c,) of the first episodes with each of the gains (c, 2 n)."""
    arms, n = len(gains) * episodes, gains.shape[1] // 2
    stiffness, damping = np.split(np.repeat(gains, episodes, axis=0), 2, axis=1)
    limits = environment.setup().torque_limit
    model = gym.make(environment.id, **environment.keywords()).unwrapped.simulator.model  # type: ignore[attr-defined]
    base = PD([0.0] * n, [0.0] * n, limits, model if model.constants.gravity.any() else None)
    base.stiffness, base.damping = stiffness, damping
    venv = gym.make_vec(environment.id, arms, "vector_entry_point", **environment.keywords() | {"base": base})
    venv.reset(seed=np.tile(np.arange(episodes), len(gains)).tolist())
    still = np.zeros(venv.action_space.shape or (), dtype=np.float32)
    total, playing = np.zeros(arms), np.ones(arms, dtype=bool)  # next episodes do not count
    while playing.any():
        _, rewards, terminated, truncated, _ = venv.step(still)
        total += np.where(playing, rewards, 0.0)
        playing &= ~(terminated | truncated)
    return total.reshape(len(gains), episodes).mean(axis=1)
