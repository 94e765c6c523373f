"""Base sway: an effect that swings the base to and fro."""

from typing import ClassVar

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray
from flexman_gym.checks import non_negative
from flexman_gym.envs.effects.effect import Range, Stage
from flexman_gym.model.instant import frequencies

SLOWEST, QUICKEST = 0.3, 3.0  # times the first mode of the arm with its motors held
RIGID = 1.0  # Hz, in place of the first mode of an arm that does not bend


class BaseSway:
    """Amplitude, m/s^2, of a sine by which the base is accelerated; direction, frequency and phase are random.

    The frequency is between 0.3 and 3 times that of the first mode of the arm at zero angles with its motors held,
    evenly on a logarithmic scale.
    """

    kind: ClassVar[type] = float
    kept = ("_sway",)
    shape = ()

    def __init__(self, stage: Stage, span: Range) -> None:
        self._batch, self._span = stage.batch, span
        first = frequencies(stage.batch.model, lock_joints=True)[:1]
        self._first = float(first[0]) if len(first) else RIGID
        self._sway = np.zeros((len(stage.batch.rows), 5))  # acceleration (3,), Hz and rad

    @staticmethod
    def checked(field: str, value: object) -> float:
        """An amplitude >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> float:
        """The amplitude; its generator gives the rest."""
        inner = np.random.default_rng(stream.integers(2**63))
        way, amplitude = inner.normal(size=3), float(inner.uniform(*self._span))
        frequency = self._first * np.exp(inner.uniform(np.log(SLOWEST), np.log(QUICKEST)))
        self._sway[arm] = *(way / np.sqrt(way @ way)), frequency, inner.uniform(0.0, 2.0 * np.pi)
        return amplitude

    def begin(self, arms: IntArray, drawn: Array) -> None:
        """Makes the directions as long as the amplitudes."""
        self._sway[arms, :3] *= drawn[arms][:, None]

    def add_base_accelerations(self, accelerations: Array, over: Flags) -> None:
        """Adds the accelerations in the middle of this period."""
        time = self._batch.time + 0.5 * self._batch.control_period
        size = np.sin(2.0 * np.pi * self._sway[:, 3] * time + self._sway[:, 4])
        accelerations += self._sway[:, :3] * (size * ~over)[:, None]
