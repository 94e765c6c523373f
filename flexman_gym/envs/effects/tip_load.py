"""Tip load: an effect that hangs a force on the tip and changes it at random times."""

from typing import Any, ClassVar

import numpy as np

from flexman_gym.arrays import Array, Flags
from flexman_gym.checks import non_negative
from flexman_gym.envs.effects.effect import Range, Stage


class TipLoad:
    """Forces, N, on the tip that stay until the next change of load, of random directions and at random times.

    The first one acts from the start of the episode on. The mean time between two of them is `impulse_gap`.
    """

    kind: ClassVar[type] = float
    kept = ("_inner", "_wait", "_forces")
    shape = None

    def __init__(self, stage: Stage, span: Range) -> None:
        self._share, self._span = stage.batch.control_period / stage.impulse_gap, span
        arms = len(stage.batch.rows)
        self._inner: list[Any] = [None] * arms
        self._wait, self._forces = np.zeros(arms, dtype=np.int64), np.zeros((arms, 3))

    @staticmethod
    def checked(field: str, value: object) -> float:
        """A size >= 0."""
        return non_negative(field, value)

    def draw(self, arm: int, stream: np.random.Generator) -> None:
        """The generator of the loads of an episode."""
        self._inner[arm], self._wait[arm] = np.random.default_rng(stream.integers(2**63)), 0

    def add_tip_forces(self, forces: Array, over: Flags) -> None:
        """Adds the loads; those whose time has come change first."""
        for arm in np.flatnonzero((self._wait <= 0) & ~over).tolist():
            inner = self._inner[arm]
            size, way = inner.uniform(*self._span), inner.normal(size=3)
            self._forces[arm] = size * way / np.sqrt(way @ way)
            self._wait[arm] = inner.geometric(self._share)
        self._wait -= 1
        forces += self._forces * ~over[:, None]
