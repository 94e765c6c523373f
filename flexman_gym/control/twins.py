"""Twins: arms that a controller simulates for itself, beside those that it acts on."""

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

    def __deepcopy__(self, memo: object) -> "Twins":
        return Twins(self._plant)
