"""Random postures of an arm within the angle ranges of its joints."""

from typing import NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.scene.arm import Arm

TURN = 2.0 * np.pi  # rad


class PostureRanges(NamedTuple):
    """Ranges of the joint angles of an arm, and the posture in their middle.

    Attributes:
        home: (n,) middle of the range of each joint, 0 for a joint without a range, rad.
        low: (n,) least angles, rad; -inf for a joint without a range.
        high: (n,) largest angles, rad; inf for a joint without a range.
    """

    home: Array
    low: Array
    high: Array

    @classmethod
    def of(cls, arm: Arm) -> Self:
        """Return the ranges of an arm."""
        ranges = np.array([(-np.inf, np.inf) if each is None else each for each in arm.angle_ranges])
        return cls(np.array(arm.home), ranges[:, 0], ranges[:, 1])

    def start_span(self, largest: float) -> Array:
        """Return the largest differences (n,) of a start from `home`, at most `largest`, rad."""
        free = np.isinf(self.high)
        return np.where(free, largest, np.minimum(largest, np.where(free, 0.0, self.high - self.home)))

    def change_bounds(self, starts: Array, largest: float) -> tuple[Array, Array]:
        """Return the least and the largest changes (..., n) of angles from starts (..., n), at most `largest`, rad."""
        return np.maximum(-largest, self.low - starts), np.minimum(largest, self.high - starts)

    def draw_starts(self, random: np.random.Generator, largest: float, size: tuple[int, ...] = ()) -> Array:
        """Draw postures (*size, n) around `home`, rad."""
        span = self.start_span(largest)
        return self.home + random.uniform(-span, span, (*size, len(span)))

    def draw_changes(self, random: np.random.Generator, starts: Array, largest: float) -> Array:
        """Draw changes (..., n) of angles from starts (..., n) within the ranges, rad."""
        return random.uniform(*self.change_bounds(starts, largest), starts.shape)

    def contains(self, postures: Array) -> bool:
        """Return True if postures (..., n), rad, are within the ranges."""
        return bool(np.all((postures >= self.low) & (postures <= self.high)))

    def turned_into(self, posture: Array) -> Array:
        """Return a posture (n,) with each angle that is outside its range turned by whole turns towards the middle."""
        outside = (posture < self.low) | (posture > self.high)
        return np.where(outside, posture - TURN * np.round((posture - self.home) / TURN), posture)
