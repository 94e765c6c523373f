"""Effect: what a randomisation may do to what passes between an agent and its arms."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.envs.limits import Limits
from flexman_gym.simulation.batch import Batch

Range = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Stage:
    """What effects act on.

    Attributes:
        batch, limits: the arms and their limits.
        bound: (size,) range of each quantity that is measured.
        torque_limits: (b, n) N m, which effects may overwrite; `nominal` (n,) is what they are without.
        impulse_gap: s.
    """

    batch: Batch
    limits: Limits
    bound: Array
    torque_limits: Array
    nominal: Array
    impulse_gap: float


class Effect(Protocol):
    """An effect on b arms. A class with `checked`, `shape`, `draw` and at least one of the hooks is one.

    Hooks: `begin(arms, drawn)` after the draws of new episodes of the arms (r,), with what every arm drew (b, ...);
    `bend(arms, states)` changes the states (r, 2 d) that they start from; `act(actions)` returns what reaches the
    motors of actions (b, n); `push(forces, over)` adds to forces (b, 3) N on the tips, and `shake(accelerations, over)`
    to accelerations (b, 3) m/s^2 of the bases, of arms whose episode is not over; `measure(values, arms)` returns what
    is measured of the values (r, size) of the arms (r,), before anything is derived from it.
    """

    def __init__(self, stage: Stage, span: Range) -> None: ...

    @staticmethod
    def checked(field: str, value: object) -> float:
        """One end of the range, checked."""
        ...

    @property
    def shape(self) -> tuple[int, ...] | None:
        """Of what an episode draws; None where that is not told."""
        ...

    def draw(self, arm: int, stream: np.random.Generator) -> Any:
        """What the episode of an arm draws: one draw of its stream, the rest from a generator that this draw seeds."""
        ...
