"""Feedback: a controller made of an observer and the law that tracks references by what the observer says."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray, grown
from flexman_gym.control.controller import Controller, Episode, Readings
from flexman_gym.control.observer import Estimate, Observer
from flexman_gym.control.tracking import Tracking


class OutputFeedback:
    """Torques of a tracking law on the state that an observer estimates.

    Where the observer says that it is wrong, as its readings cannot be explained by any arm that it knows, a fallback
    takes over until the episode ends.

    Args:
        observer: says where the arm is, and what it is like. Its optional member `wrong`, (b,) flags, says where not.
        law: that follows references.
        fallback: that needs no model, such as a PD; None for none.
    """

    kept = ("observer", "law", "fallback", "_given_up", "_looked", "_known")

    def __init__(self, observer: Observer, law: Tracking, fallback: Controller | None = None) -> None:
        self.observer, self.law, self.fallback = observer, law, fallback
        self.sensors = (*observer.sensors, *(fallback.sensors if fallback else ()))
        self._given_up, self._looked = np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)
        self._known: dict[str, Any] = {}  # the estimate of arms that have been looked at in this period

    @property
    def estimates(self) -> Mapping[str, Array]:
        """What the observer says of the arms, name -> (b, ...)."""
        return getattr(self.observer, "estimates", {})

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms (r,)."""
        self.observer.reset(arms, episode)
        self.law.reset(arms, episode)
        if self.fallback:
            self.fallback.reset(arms, episode)
        for name in ("_given_up", "_looked"):
            setattr(self, name, grown(getattr(self, name), int(arms.max(initial=-1)) + 1))
            getattr(self, name)[arms] = False

    def look(self, readings: Readings, applied: Array, playing: Flags) -> Estimate:
        """Gives what the observer says of the arms (b,) that are playing, who is asked once a period of each."""
        due = playing & ~self._looked
        if self._known and not due.any():
            return Estimate(**self._known)
        estimate = self.observer.estimate(readings, applied, due)
        self._given_up |= getattr(self.observer, "wrong", False)
        if self._looked.any():
            states = np.where(due[:, None], estimate.states, self._known["states"])
            estimate = estimate._replace(states=states)
        self._known, self._looked = estimate._asdict(), self._looked | due
        return estimate

    def act(self, readings: Readings, applied: Array, playing: Flags) -> Array:
        """Gives actions (b, n), parts of the torque limits."""
        estimate = self.look(readings, applied, playing)
        self._looked &= ~playing
        torques = self.law.torques(estimate, playing & ~self._given_up) - estimate.disturbance
        result = np.clip(torques / self.law.limits, -1.0, 1.0)
        if self.fallback and self._given_up.any():
            safe = np.asarray(self.fallback.act(readings, applied, playing), dtype=float)
            result = np.where(self._given_up[:, None], safe, result)
        if not self._looked.any():
            self._known = {}
        return result
