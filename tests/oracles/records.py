"""Synthetic episodes with known metrics."""

import numpy as np

from flexman_gym.evaluation.rollouts import EpisodeRecord

PERIOD, LENGTH = 0.02, 500  # s, control periods


def record(reward=123.4, settled=2.5, vibration=0.0012, error=0.0034, effort=0.25, failure="", joints=2, band=0.02):
    """Return an episode of 10 s with given metrics; the tip vibrates with a whole number of cycles per second."""
    time = PERIOD * np.arange(LENGTH + 1)
    tips = np.zeros((LENGTH + 1, 3))
    tips[:, 1] = 0.5 * vibration * np.cos(2.0 * np.pi * time)
    errors = np.where(time > min(settled, 8.9) - 0.5 * PERIOD, error, 1.0)
    errors[-1] += 0.1 * (not np.isfinite(settled))  # which leaves the median of the last second
    actions, rewards = np.full((LENGTH, joints), np.sqrt(effort)), np.full(LENGTH, reward / LENGTH)
    return EpisodeRecord(tips, errors, actions, rewards, failure, PERIOD, band)
