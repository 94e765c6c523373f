"""Effect protocol: disturbance of the signals between an agent and its arms."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.envs.limits import Limits
from flexman_gym.simulation.batch import Batch

Range = tuple[float, float]
"""Least and largest value of a draw."""


@dataclass(frozen=True, eq=False)
class EffectContext:
    """Arms and signals on which effects act.

    Attributes:
        batch: simulated arms.
        limits: limits of their motion.
        bound: (size,) range of each measured quantity.
        torque_limits: (b, n) present torque limits, N m; effects may overwrite them.
        nominal: (n,) torque limits without effects, N m.
        impulse_gap: mean time between two impulses or two changes of load, s.
    """

    batch: Batch
    limits: Limits
    bound: Array
    torque_limits: Array
    nominal: Array
    impulse_gap: float


HOOKS = ("begin", "change_start", "motor_actions", "add_tip_forces", "add_base_accelerations", "measure")
"""Optional methods of an effect, in the order of a control period."""


class Effect(Protocol):
    """Protocol of an effect on b arms: `checked`, `shape`, `draw` and at least one of the HOOKS.

    With an attribute `factor = True` the effect draws factors on a nominal value, and its range is named "..._factor".

    Hooks; a misspelt name is refused:
        begin(arms, drawn): starts new episodes of the arms (r,), with the drawn values (b, ...) of all arms.
        change_start(arms, states): changes the initial states (r, 2 d) in place.
        motor_actions(actions): returns the actions (b, n) that reach the motors.
        add_tip_forces(forces, over): adds forces (b, 3), N, at the tips of arms in an episode.
        add_base_accelerations(accelerations, over): adds accelerations (b, 3), m/s^2, of their bases.
        measure(values, arms): returns the measured values (r, size) of the arms (r,), before any quantity is derived
            from them.
    """

    def __init__(self, context: EffectContext, span: Range) -> None: ...

    @staticmethod
    def checked(field: str, value: object) -> float:
        """Return one end of the range after a check."""
        ...

    @property
    def shape(self) -> tuple[int, ...] | None:
        """Shape of the drawn value; None if it is not reported in `info`."""
        ...

    def draw(self, arm: int, stream: np.random.Generator) -> Any:
        """Return the value of an episode of an arm.

        An effect draws once from its stream; a generator seeded by this draw supplies all further random numbers.
        """
        ...
