"""Motors: what may be asked of them, and the torques that it becomes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from flexman_gym.arrays import Array
from flexman_gym.checks import number_array, refusal
from flexman_gym.kernels.periods import within

ROUNDING = 1e-6  # of float32 and of what is computed in it, on numbers near 1


def action_space(size: int) -> spaces.Space[Any]:
    """The space of actions of one arm, of so many numbers."""
    return spaces.Box(-1.0, 1.0, (size,), dtype=np.float32)


def checked_actions(name: str, value: object, shape: tuple[int, ...], allowed: str) -> Array:
    """The actions as a new array of floats; raises ValueError for another shape and for numbers outside -1 to 1.

    Numbers beyond by what float32 may round, less than 1e-6, count as -1 or 1.
    """
    if isinstance(value, np.ndarray) and value.shape == shape and value.dtype.kind == "f":
        actions = value.astype(np.float64, order="C")
    else:
        actions = number_array(name, value, shape, allowed).astype(np.float64, order="C")
    if within(actions.ravel(), 1.0):
        return actions
    if np.count_nonzero(np.abs(actions) < 1.0 + ROUNDING) == actions.size:
        return np.clip(actions, -1.0, 1.0)
    raise refusal(name, value, allowed)


class Motors:
    """The motors of b arms of n joints, and what else drives the arms.

    Attributes:
        limits: (b, n) N m, the torque limits, which effects may change.
        drive: (b, n + 6) of `Batch.step`, of which the following are views.
        torques: (b, n) N m, of the last control period.
        forces: (b, 3) N, on the tips in the base frame.
        accelerations: (b, 3) m/s^2, of the bases in the base frame.
        reached: (b, n) where drives with a bandwidth are, parts of the limits; they start at 0.
    """

    kept = ("limits", "forces", "accelerations", "reached")

    def __init__(self, limits: Sequence[float], arms: int, lag: tuple[float, float] | None = None) -> None:
        joints = len(limits)
        self.limits, self._lag = np.tile(limits, (arms, 1)), lag
        self.reached = np.zeros((arms, joints if lag else 0))
        self.drive = np.zeros((arms, joints + 6))
        self.torques, self.forces = self.drive[:, :joints], self.drive[:, joints : joints + 3]
        self.accelerations = self.drive[:, joints + 3 :]

    def followed(self, actions: Array) -> Array:
        """What torques (b, n) are in the mean of a period for arriving actions (b, n), parts of the limits.

        Drives that lag follow them late; see `control.margins.lag`.
        """
        if self._lag is None:
            return actions
        missing = self.reached - actions
        self.reached[:] = actions + self._lag[0] * missing
        return actions + self._lag[1] * missing
