"""Tuning: gains of a PD controller for the arm of an environment, by a random search."""

from dataclasses import dataclass

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.control.pd import PD, stability_limit
from flexman_gym.envs.description import Description
from flexman_gym.envs.setup import build
from flexman_gym.evaluation.rollout import rollout

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
    n = gains.shape[1] // 2
    stiffness, damping = np.split(np.repeat(gains, episodes, axis=0), 2, axis=1)
    setup = environment.setup()
    model = build(setup).model if any(setup.arm.gravity) else None
    base = PD([0.0] * n, [0.0] * n, setup.torque_limit, model)
    base.stiffness, base.damping = stiffness, damping
    rewards = rollout(base, environment, np.tile(np.arange(episodes), len(gains)).tolist()).rewards
    return np.nansum(rewards, axis=1).reshape(len(gains), episodes).mean(axis=1)
