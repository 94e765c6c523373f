"""Energy: the scale of its error, and when an integrator has invented or lost too much of it."""

from typing import Any

import numpy as np

from flexman_gym.arrays import Array

ENERGY_ALARM = 0.01  # of the energy turned over


def turnover(moving_energy: Array | float, work: Array | float, dissipation: Array | float) -> Array:
    """Gives the largest magnitude of the three energies, the scale of an error of the energy, J."""
    return np.maximum(np.maximum(moving_energy, np.abs(work)), np.abs(dissipation))


def alarm(residual: Any, turned_over: Any, level: float = ENERGY_ALARM) -> Any:
    """Tells whether a residual of the energy is more than a part of the energy turned over.

    Args:
        residual: number or array, J.
        turned_over: number or array, J.
        level: the part.
    """
    return abs(residual) > level * turned_over
