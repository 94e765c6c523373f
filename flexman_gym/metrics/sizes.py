"""Sizes: how large a signal was over all of its time."""

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import physical
from flexman_gym.metrics.samples import finite_samples, lengths


def rms(values: Array) -> float:
    """Gives the root mean square of numbers (T,), or of the lengths of vectors (T, k), in their unit.

    Of errors it is the RMS tracking error, of deflections (T, 3) the RMS deflection.

    Raises:
        ValueError: for other arrays, and for numbers that are not finite.
    """
    return float(np.sqrt(np.mean(np.square(lengths(finite_samples("values", values, 1, 2))))))


def squared_acceleration(accelerations: Array, period: float) -> float:
    """Gives the integral over time of the squared acceleration of the tip, m^2/s^3.

    It is the cost that a minimum-acceleration motion makes least (Ben-Itzhak and Karniel, Minimum acceleration
    criterion with constraints, Neural Computation 2008). The integral is that of the trapezoidal rule.

    Args:
        accelerations: (T, 3) m/s^2, or (T,) along one axis.
        period: between samples, s.

    Raises:
        ValueError: for fewer than two samples, numbers that are not finite, and a period that is not > 0.
    """
    result = np.square(lengths(finite_samples("accelerations", accelerations, 1, 2, least=2)))
    return float(np.trapezoid(result, dx=physical("period", period, "s")))
