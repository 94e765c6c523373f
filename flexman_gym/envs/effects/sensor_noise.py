"""Sensor noise: an effect that adds normal noise to observations."""

from typing import Any, ClassVar

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import non_negative
from flexman_gym.envs.effects.effect import Range, Stage

BLOCK = 32  # observations whose noise is drawn at once
TRUNCATION = 4.0  # standard deviations; noise beyond it is drawn again


class SensorNoise:
    """Standard deviation of normal noise on each number of each observation, as a part of its bound.

    A number beyond 4 standard deviations is drawn again. The bounds of the observation space grow by 4 times the
    largest standard deviation; whether an arm leaves its limits is decided without noise.
    """

    kind: ClassVar[type] = float
    kept = ("_inner", "_noise", "_used", "_deviation")
    shape = ()

    def __init__(self, stage: Stage, span: Range) -> None:
        arms = len(stage.batch.rows)
        self._bound, self._span, self.growth = stage.bound, span, TRUNCATION * span[1]
        self._inner: list[Any] = [None] * arms
        self._noise, self._used = np.zeros((arms, BLOCK, len(stage.bound))), np.zeros(arms, dtype=np.int64)
        self._deviation, self._all = np.zeros((arms, 1)), np.arange(arms)

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A part >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> float:
        """The standard deviation."""
        self._inner[arm] = np.random.default_rng(stream.integers(2**63))
        return stream.uniform(*self._span)

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Noise of the episode before is not used."""
        self._deviation[arms, 0], self._used[arms] = drawn[arms], BLOCK

    def observe(self, observations: Array, arms: IntArray | None) -> Array:
        """Observations (r, size) of the arms (r,), or of all, with noise."""
        arms = self._all if arms is None else arms
        for arm in arms[self._used[arms] == BLOCK].tolist():
            self._noise[arm], self._used[arm] = _normal(self._inner[arm], self._noise.shape[1:]), 0
        noise = self._noise[arms, self._used[arms]]
        self._used[arms] += 1
        return observations + noise * self._deviation[arms] * self._bound


def _normal(random: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Standard normal numbers within the truncation, by rejection."""
    values = random.standard_normal(shape)
    while (beyond := np.abs(values) > TRUNCATION).any():
        values[beyond] = random.standard_normal(np.count_nonzero(beyond))
    return values
