"""Effect protocol: disturbance of the signals between an agent and its arms."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.envs.limits import Limits
from flexman_gym.simulation.batch import Batch

Range = tuple[float, float]
"""Range (low, high) of a uniform draw."""


@dataclass(frozen=True, eq=False)
class EffectContext:
    """Arms and signals of an environment, given to the constructor of each effect.

    Attributes:
        batch: simulated arms.
        limits: limits of their motion.
        bound: (size,) largest magnitude of each measured quantity.
        torque_limits: (b, n) torque limits of the current episodes, N m; effects may overwrite them.
        nominal: (n,) torque limits without effects, N m.
        impulse_gap: mean time between two impulses or two changes of load, s.
        instruments: (size,) index of the sensor that measures each quantity.
        gauges: (3 n,) indices of the root strains among the measured quantities; (0,) if no sensor measures them.
    """

    batch: Batch
    limits: Limits
    bound: Array
    torque_limits: Array
    nominal: Array
    impulse_gap: float
    instruments: IntArray
    gauges: IntArray


HOOKS = ("begin", "change_start", "motor_actions", "add_tip_forces", "add_base_accelerations", "measure")
"""Optional methods of an effect, in the order of their calls."""


class Effect(Protocol):
    """Protocol of an effect on b arms, a disturbance such as noise or delay, with at least one of the HOOKS.

    With an attribute `factor = True` the effect draws factors on a nominal value, and its range is named "..._factor".

    Hooks; a misspelt name raises ValueError:
        begin(arms, drawn): start new episodes of the arms (r,), with the drawn values (b, ...) of all arms.
        change_start(arms, states): change the initial states (r, 2 d) in place.
        motor_actions(actions): return the torques (b, n) that reach the motors, as fractions of the limits, for
            commanded torques (b, n).
        add_tip_forces(forces, over): add forces (b, 3), N, at the tips; `over` (b,) is True for arms without a running
            episode.
        add_base_accelerations(accelerations, over): add accelerations (b, 3), m/s^2, of the bases.
        measure(values, arms): return the measured values (r, size) of the arms (r,) for true values (r, size); errors
            and other derived quantities are computed from the result.
    """

    def __init__(self, context: EffectContext, span: Range) -> None: ...

    @staticmethod
    def checked(field: str, value: object) -> float:
        """Check the lower or upper end of the range and return it; `field` is its name in the error message."""
        ...

    @property
    def shape(self) -> tuple[int, ...] | None:
        """Shape of the drawn value; None if it is not reported in `info`."""
        ...

    def draw(self, arm: int, stream: np.random.Generator) -> Any:
        """Draw the value for an episode of an arm.

        An effect draws once from its stream; a generator seeded by this draw supplies all further random numbers.
        """
        ...
