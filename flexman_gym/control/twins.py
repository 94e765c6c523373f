"""Twins: arms that a controller simulates for itself, beside those that it acts on."""

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.control.plant import Plant
from flexman_gym.simulation.batch import Batch


class Twins:
    """Batches of the arm of a plant, made when they are asked for.

    A batch cannot be copied; the copy of a controller makes its own and begins with the next episodes.

    Args:
        plant: the arm, and how it is simulated.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant, self._batches = plant, dict[tuple[str, int], Batch]()

    def __call__(self, purpose: str, arms: int) -> Batch:
        """Gives the batch of so many arms that serves a purpose, the same one each time."""
        key = purpose, arms
        if key not in self._batches:
            plant = self._plant
            self._batches[key] = Batch(plant.model, *plant.moved, plant.period, arms=arms)
        return self._batches[key]

    def moved(self, twins: tuple[str, int], arms: IntArray, states: Array, forces: Array) -> Array:
        """Gives the states (r, 2 d) a control period after others.

        Args:
            twins: purpose and number of the arms of a batch.
            arms: (r,) those that move.
            states: (r, 2 d) before.
            forces: (r, k) the first of the n + 6 numbers of a drive, see `Batch.step`.
        """
        batch = self(*twins)
        drive, moving = np.zeros((twins[1], self._plant.model.n_joints + 6)), np.zeros(twins[1], dtype=bool)
        drive[arms, : forces.shape[1]], moving[arms] = forces, True
        batch.place(arms, states)
        batch.step(drive, None if moving.all() else moving)
        result: Array = batch.state[arms]
        return result

    def __deepcopy__(self, memo: object) -> "Twins":
        return Twins(self._plant)
