"""Torque limit: an effect that makes motors weaker or stronger."""

from typing import ClassVar

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import positive
from flexman_gym.envs.effects.effect import Range, Stage


class TorqueLimit:
    """Factors > 0 on the torque limits, one for each joint."""

    kind: ClassVar[type] = float
    factor: ClassVar[bool] = True

    def __init__(self, stage: Stage, span: Range) -> None:
        self._stage, self._span, self.shape = stage, span, stage.nominal.shape

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A factor > 0."""
        return positive(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> Array:
        """Torque limits, N m."""
        return stream.uniform(*self._span, self.shape) * self._stage.nominal

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Sets the limits."""
        self._stage.torque_limits[arms] = drawn[arms]
