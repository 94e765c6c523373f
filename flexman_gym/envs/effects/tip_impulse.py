"""Tip impulse: an effect that hits the tip at random times."""

from typing import Any, ClassVar

import numpy as np

from flexman_gym.arrays import Array, Flags
from flexman_gym.checks import non_negative
from flexman_gym.envs.effects.effect import Range, Stage


class TipImpulse:
    """Impulses, N s, of random directions, each a force on the tip during one control period, at random times."""

    kind: ClassVar[type] = float
    kept = ("_inner", "_wait")
    shape = None

    def __init__(self, stage: Stage, span: Range) -> None:
        self._period, self._gap_time, self._span = stage.batch.control_period, stage.impulse_gap, span
        arms = len(stage.batch.rows)
        self._inner: list[Any] = [None] * arms
        self._wait = np.zeros(arms, dtype=np.int64)

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A size >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> None:
        """The time until the first impulse."""
        self._inner[arm] = np.random.default_rng(stream.integers(2**63))
        self._wait[arm] = self._gap(arm)

    def add_tip_forces(self, forces: Array, over: Flags) -> None:
        """Adds the forces during this period; arms whose episode is over wait."""
        self._wait -= 1
        for arm in np.flatnonzero((self._wait <= 0) & ~over).tolist():
            inner = self._inner[arm]
            size, way = inner.uniform(*self._span), inner.normal(size=3)
            forces[arm] += size / self._period * way / np.sqrt(way @ way)
            self._wait[arm] = self._gap(arm)

    def _gap(self, arm: int) -> int:
        """Periods until the next impulse."""
        return int(self._inner[arm].geometric(self._period / self._gap_time))
