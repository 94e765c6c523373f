"""Effect: what a randomisation may do to what passes between an agent and its arms."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.envs.limits import Limits
from flexman_gym.simulation.batch import Batch

Range = tuple[float, float]
"""Least and largest value that may be drawn."""


@dataclass(frozen=True, eq=False)
class EffectContext:
    """What effects act on.

    Attributes:
        batch: the arms.
        limits: their limits.
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


HOOKS = ("begin", "change_start", "motor_actions", "add_tip_forces", "add_base_accelerations", "measure")
"""Methods of an effect, in the order of a control period; each may be left out."""


class Effect(Protocol):
    """An effect on b arms. A class with `checked`, `shape`, `draw` and at least one of the HOOKS is one.

    It may say `factor = True`, where it draws factors on what is nominal: its range is then named "..._factor".

    Its hooks, of which a misspelt one is refused:
        begin(arms, drawn): after the draws of new episodes of the arms (r,), with what every arm drew (b, ...).
        change_start(arms, states): changes the states (r, 2 d) from which they start.
        motor_actions(actions): returns what reaches the motors of actions (b, n).
        add_tip_forces(forces, over): adds to forces (b, 3) N on the tips of arms whose episode is not over.
        add_base_accelerations(accelerations, over): adds to accelerations (b, 3) m/s^2 of their bases.
        measure(values, arms): returns what is measured of the values (r, size) of the arms (r,), before anything is
            derived from it.
    """

    def __init__(self, stage: EffectContext, span: Range) -> None: ...

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
