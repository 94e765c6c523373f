"""Delay: an effect that lets torques come late."""

from typing import ClassVar

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import whole_number
from flexman_gym.envs.effects.effect import Range, Stage

LONGEST_DELAY = 1000  # control periods


class Delay:
    """Whole control periods by which torques come late; before the first there is none."""

    kind: ClassVar[type] = int
    kept = ("_past", "_late", "_now")
    shape = ()

    def __init__(self, stage: Stage, span: Range) -> None:
        arms, n = stage.torque_limits.shape
        self._span = span
        self._past, self._late = np.zeros((1 + int(span[1]), arms, n)), np.zeros(arms, dtype=np.int64)
        self._now, self._all = 0, np.arange(arms)

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A whole number of periods."""
        return whole_number(field, value, 0, LONGEST_DELAY)

    def draw(self, arm: int, stream: np.random.Generator) -> int:
        """The number of periods."""
        low, high = map(int, self._span)
        return int(stream.integers(low, high + 1))

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Torques of the episode before do not arrive."""
        self._late[arms] = drawn[arms]
        self._past[:, arms] = 0.0

    def motor_actions(self, actions: Array) -> Array:
        """Keeps the actions (b, n) and returns those that reach the motors now."""
        depth = len(self._past)
        self._now = (self._now + 1) % depth
        self._past[self._now] = actions
        return self._past[(self._now - self._late) % depth, self._all]
