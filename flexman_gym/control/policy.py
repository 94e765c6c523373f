"""Policy: a learned policy as a controller, with its sensors, its memory, its hold, and the base it learned beside."""

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array, Flags, IntArray, grown
from flexman_gym.checks import refusal
from flexman_gym.control.controller import Controller, Episode, Readings
from flexman_gym.control.history import History, parts_of
from flexman_gym.control.network import Network


class Policy:
    """Actions of a network on what its sensors read, each for `hold` control periods, added to those of a base.

    Args:
        network: gives actions (b, n) for observations (b, size).
        sensors: that it learned with, in their order, those of its task included.
        history: observations, or times (s) of averages, see `History`.
        hold: control periods for which an action is kept (action repeat).
        base: what acts beside it, so that its actions are a residual; None for nothing.
    """

    kept = ("_ages", "_actions", "_past", "base")

    def __init__(
        self,
        network: Network,
        sensors: tuple[object, ...],
        history: int | tuple[float, ...] = 1,
        hold: int = 1,
        base: Controller | None = None,
    ) -> None:
        self.network, self._kind, self._hold, self.base = network, history, hold, base
        self.sensors = (*sensors, *(base.sensors if base else ()))
        self._parts = parts_of(history)
        self._ages, self._actions = np.zeros(0, dtype=np.int64), np.zeros((0, network.joints), dtype=np.float32)
        self._past = self._history(0, 1.0)

    def _history(self, arms: int, period: float) -> History:
        return History(self._kind, self._hold * period, arms, self.network.size // self._parts)

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms (r,)."""
        if episode.start.shape[1] != self.network.joints:
            raise refusal("base", f"a policy of {self.network.joints} motors", f"one of {episode.start.shape[1]}")
        count = int(arms.max(initial=-1)) + 1
        if count > len(self._ages):
            self._ages, self._actions = grown(self._ages, count), grown(self._actions, count)
            self._past = self._history(count, episode.period).following(self._past)
        self._ages[arms] = 0
        if self.base:
            self.base.reset(arms, episode)

    def act(self, readings: Readings, applied: Array, playing: Flags) -> NDArray[np.floating]:
        """Gives the actions (b, n); the network is asked anew where an action has lasted.

        Raises:
            ValueError: for readings of another size than it learned with.
        """
        due = playing & (self._ages % self._hold == 0)
        if due.any():
            now = self._observed(readings)
            for arms, see in ((due & (self._ages == 0), self._past.begin), (due & (self._ages > 0), self._past.add)):
                rows = np.flatnonzero(arms)
                if len(rows):
                    self._actions[rows] = self.network(see(now[rows], rows).astype(np.float32))
        self._ages += playing
        if self.base is None:
            return self._actions.copy()
        beside = np.asarray(self.base.act(readings, applied, playing), dtype=np.float64)
        return np.clip(beside + self._actions, -1.0, 1.0)

    def _observed(self, readings: Readings) -> Array:
        """What its own sensors read (b, size), which stands before what those of the base do."""
        parts: list[Array] = []
        size, wanted = 0, self.network.size // self._parts
        for values in readings.values():
            if size >= wanted:
                break
            parts.append(values)
            size += values.shape[1]
        if size != wanted:
            raise refusal(
                "base", f"a policy of {wanted} observed numbers", f"one of {size}, which its sensors read here"
            )
        return np.concatenate(parts, axis=1)
