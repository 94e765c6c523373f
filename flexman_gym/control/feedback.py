"""Feedback: a controller made of an observer and the law that tracks references by what the observer says."""

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray
from flexman_gym.control.controller import Episode, Readings
from flexman_gym.control.observer import Observer
from flexman_gym.control.tracking import Tracking


class OutputFeedback:
    """Torques of a tracking law on the state that an observer estimates.

    Args:
        observer: says where the arm is, and what it is like.
        law: that follows references.
    """

    kept = ("observer", "law")

    def __init__(self, observer: Observer, law: Tracking) -> None:
        self.observer, self.law, self.sensors = observer, law, tuple(observer.sensors)

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms (r,)."""
        self.observer.reset(arms, episode)
        self.law.reset(arms, episode)

    def act(self, readings: Readings, applied: Array, playing: Flags) -> Array:
        """Gives actions (b, n), parts of the torque limits."""
        estimate = self.observer.estimate(readings, applied, playing)
        return np.clip(self.law.torques(estimate, playing) / self.law.limits, -1.0, 1.0)
