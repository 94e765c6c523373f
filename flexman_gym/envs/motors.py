"""Motors: what may be asked of them, and the torques that it becomes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from flexman_gym.arrays import Array
from flexman_gym.checks import number_array, refusal
from flexman_gym.model.model import Model

ROUNDING = 1e-6  # of float32 and of what is computed in it, on numbers near 1


def action_space(model: Model) -> spaces.Space[Any]:
    """The space of actions of one arm."""
    return spaces.Box(-1.0, 1.0, (model.n_joints,), dtype=np.float32)


def checked_actions(name: str, value: object, shape: tuple[int, ...], allowed: str) -> Array:
    """The actions as an array of floats; raises ValueError for another shape and for numbers outside -1 to 1.

    Numbers beyond by what float32 may round, less than 1e-6, count as -1 or 1.
    """
    if isinstance(value, np.ndarray) and value.shape == shape and value.dtype.kind == "f":
        actions = value.astype(np.float64, copy=False)
    else:
        actions = number_array(name, value, shape, allowed)
    if np.count_nonzero(np.abs(actions) <= 1.0) == actions.size:  # neither is what is no number
        return actions
    if np.count_nonzero(np.abs(actions) < 1.0 + ROUNDING) == actions.size:
        return np.clip(actions, -1.0, 1.0)
    raise refusal(name, value, allowed)


class Motors:
    """The motors of b arms of n joints, and what else drives the arms.

    Attributes:
        limits: (b, n) N m, the torque limits, which effects may change.
        torques: (b, n) N m, of the last control period.
        forces: (b, 3) N, on the tips in the base frame.
        accelerations: (b, 3) m/s^2, of the bases in the base frame.
    """

    kept = ("limits", "forces", "accelerations")

    def __init__(self, limits: Sequence[float], arms: int) -> None:
        joints = len(limits)
        self.limits = np.tile(limits, (arms, 1))
        self._drive = np.zeros((arms, joints + 6))
        self.torques, self.forces = self._drive[:, :joints], self._drive[:, joints : joints + 3]
        self.accelerations = self._drive[:, joints + 3 :]

    def drive(self, actions: Array) -> Array:
        """The drive (b, n + 6) of `Batch.step`: torques of actions (b, n), parts of the limits, and the forces."""
        np.multiply(actions, self.limits, out=self.torques)
        return self._drive
