"""Slopes: how the state after a control period follows from the state and the torques before it, by the simulator."""

import numpy as np

from flexman_gym.arrays import Array, Flags
from flexman_gym.control.bases import Plant
from flexman_gym.model.linear import coordinate_sizes
from flexman_gym.simulation.batch import Batch

TOGETHER = 16  # arms whose neighbours are moved at once, for the memory that they take
STATE, TORQUE = 1e-5, 1e-3  # by which coordinates (of their size) and torques (of their limit) are changed


class Slopes:
    """Differences of arms that move beside one another, each from a state or under a torque that differs in one number.

    At rest they are the exact zero-order hold of `control.discrete`, to the error of the integration method.

    Args:
        plant: the arm, and how it is simulated.
    """

    def __init__(self, plant: Plant) -> None:
        model, n = plant.model, plant.model.n_joints
        self._changes = np.concatenate([np.tile(STATE * coordinate_sizes(model), 2), TORQUE * np.array(plant.torque_limit)])
        size = len(self._changes) - n
        self._around = np.zeros((1 + len(self._changes), size + n))  # the arm itself, then its neighbours
        self._around[1:] = np.diag(self._changes)
        self._size = size
        self._batch = Batch(model, *plant.moved, plant.period, arms=TOGETHER * len(self._around))

    def __call__(self, states: Array, torques: Array) -> tuple[Array, Flags]:
        """Gives slopes (r, 2 d, 2 d + n) at states (r, 2 d) under torques (r, n) N m; flags (r,) where they are good."""
        result, good = np.zeros((len(states), self._size, len(self._changes))), np.zeros(len(states), dtype=bool)
        for first in range(0, len(states), TOGETHER):
            some = slice(first, first + TOGETHER)
            result[some], good[some] = self._differences(states[some], torques[some])
        return result, good

    def _differences(self, states: Array, torques: Array) -> tuple[Array, Flags]:
        batch, shape = self._batch, (len(states), len(self._around))
        used = np.arange(shape[0] * shape[1])
        near = (np.concatenate([states, torques], axis=1)[:, None] + self._around).reshape(len(used), -1)
        drive, moving = np.zeros((len(batch.rows), torques.shape[1] + 6)), np.zeros(len(batch.rows), dtype=bool)
        drive[used, : torques.shape[1]], moving[used] = near[:, self._size :], True
        batch.place(used, near[:, : self._size])
        batch.step(drive, moving)
        ends = batch.state[used].reshape(*shape, -1)
        good: Flags = (batch.status[used] == 0).reshape(shape).all(axis=1)
        return ((ends[:, 1:] - ends[:, :1]) / self._changes[:, None]).mT, good
