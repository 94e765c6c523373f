"""Residuals: whether the errors of readings are what their noise explains."""

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray, grown

FAST, SLOW = 0.1, 0.02  # parts of the last errors in their means
SURPRISING, DRIFTED = 1.45, 5.5  # mean square of errors; mean errors in the deviations that noise alone gives them
WRONG = 20.0  # mean square that nothing explains


class Residuals:
    """Means of the errors of readings of b arms, in their deviations.

    A sudden change shows in the mean square, a slow one in the mean of one reading (Gustafsson, Adaptive Filtering and
    Change Detection, 2000, chapter 3).

    Args:
        readings: m, how many there are.

    Attributes:
        misfit: (b,) mean square, 1 where all is as it was assumed.
    """

    kept = ("misfit", "_mean")

    def __init__(self, readings: int) -> None:
        self.misfit, self._mean = np.zeros(0), np.zeros((0, readings))

    def reset(self, arms: IntArray) -> None:
        """Forgets the errors of the arms (r,)."""
        count = int(arms.max(initial=-1)) + 1
        self.misfit, self._mean = grown(self.misfit, count), grown(self._mean, count)
        self.misfit[arms], self._mean[arms] = 1.0, 0.0

    def take(self, arms: IntArray, errors: Array) -> None:
        """Takes the last errors (r, m) of arms (r,)."""
        self.misfit[arms] += FAST * ((errors**2).mean(axis=1) - self.misfit[arms])
        self._mean[arms] += SLOW * (errors - self._mean[arms])

    def changed(self, arms: IntArray) -> Flags:
        """Says which of the arms (r,) have errors that noise does not explain."""
        drift = np.abs(self._mean[arms]).max(axis=1) / np.sqrt(SLOW / (2.0 - SLOW))
        result: Flags = (self.misfit[arms] > SURPRISING) | (drift > DRIFTED)
        return result

    @property
    def wrong(self) -> Flags:
        """Which arms (b,) have errors, or none that are numbers, that nothing explains."""
        result: Flags = ~(self.misfit < WRONG)
        return result
