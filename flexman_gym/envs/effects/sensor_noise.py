"""Sensor noise: an effect that adds normal noise to what is measured."""

from typing import ClassVar

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import non_negative, refusal
from flexman_gym.envs.effects.effect import Range, Stage
from flexman_gym.envs.streams import Noise


class SensorNoise:
    """Standard deviation of normal noise on each measured quantity in each control period, as a part of its range.

    A number beyond 4 standard deviations is drawn again, one beyond the range is cut off there. Goals are not measured.
    What is derived from measurements, such as errors and nearness, is as uncertain as they are. All sensors, and a
    base, see the same measurements. Whether an arm leaves its limits is decided without noise.
    """

    kind: ClassVar[type] = float
    kept = ("_noise", "_deviation")
    shape = ()

    def __init__(self, stage: Stage, span: Range) -> None:
        arms = len(stage.batch.rows)
        self._bound, self._span = stage.bound, span
        self._noise, self._deviation = Noise(arms, len(stage.bound)), np.zeros((arms, 1))

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A part from 0 to 1."""
        part = non_negative(field, value)
        if part > 1.0:
            raise refusal(field, value, "a part from 0 to 1 of the range")
        return part

    def draw(self, arm: int, stream: np.random.Generator) -> float:
        """The standard deviation."""
        self._noise.begin(arm, stream)
        return stream.uniform(*self._span)

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Takes the deviations of new episodes."""
        self._deviation[arms, 0] = drawn[arms]

    def measure(self, values: Array, arms: IntArray) -> Array:
        """Measured values (r, size) of the arms (r,) with noise."""
        return values + self._noise.sample(arms) * self._deviation[arms] * self._bound
