"""Innovations: Kalman gains for the correction of simulated arms, and change detection from residuals."""

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.control.observers.internal_model import DiscreteJacobians
from flexman_gym.control.observers.kalman_filter import measurement_update, stationary_covariance, time_update
from flexman_gym.control.observers.observer import MeasurementModel

PROCESS_NOISE, CHANGE_NOISE = (
    (0.001, 0.002),
    (0.02, 0.1),
)  # torques and forces on the tip that push, parts of their scales
RELINEARISATION_ANGLE = 0.3  # rad by which an arm has turned when its motion is linearised anew


class InnovationGains:
    """Kalman gains of b arms for the errors of their readings, with the linear motion about where an arm is.

    Args:
        slopes: of the arm.
        instruments: what is read of it.
        push: N, how large forces on the tip may be at any time.
    """

    state_fields = ("covariance", "_transition", "_noise", "_designed")

    def __init__(self, slopes: DiscreteJacobians, instruments: MeasurementModel, push: float) -> None:
        self._jacobians, self._matrix, self._push = slopes, instruments.matrix, push
        self._variances, size = instruments.deviations**2, instruments.matrix.shape[1]
        self.covariance, self._transition, self._noise = (np.zeros((0, size, size)) for _ in range(3))
        self._designed = np.zeros((0, size))

    def allocate(self, count: int) -> None:
        """Makes room for so many arms."""
        for name in self.state_fields:
            setattr(self, name, pad_rows(getattr(self, name), count))

    def begin(self, arms: IntArray, states: Array, torques: Array, sudden: bool) -> BoolArray:
        """Begins for arms (r,) at states (r, 2 d) under torques (r, n) N m; says for which of them it can.

        Args:
            arms: (r,).
            states: as they are estimated.
            torques: that act.
            sudden: whether something has just pushed them, so that the estimate is not exact.
        """
        inputs, well = self._linearise(arms, states, torques)
        noise = self._noise[arms] + sudden * self._noise_of(inputs, CHANGE_NOISE)
        covariance = stationary_covariance(self._transition[arms], noise, self._matrix, self._variances)
        result: BoolArray = well & np.isfinite(covariance).all(axis=(1, 2))
        self.covariance[arms[result]] = covariance[result]
        return result

    def _linearise(self, arms: IntArray, states: Array, torques: Array) -> tuple[Array, BoolArray]:
        """Takes the slopes of the motion of arms (r,); gives those by forces, and says where they are good."""
        slopes, good = self._jacobians(states, torques)
        some, inputs = arms[good], slopes[..., states.shape[1] :]
        self._transition[some] = slopes[good][..., : states.shape[1]]
        self._noise[some] = self._noise_of(inputs[good], PROCESS_NOISE)
        self._designed[some] = states[good]
        return inputs, good

    def _noise_of(self, inputs: Array, parts: tuple[float, float]) -> Array:
        """The covariance (r, 2 d, 2 d) of what forces, parts of their scales, add in a period."""
        scales = self._jacobians.scales
        forces = np.repeat(parts, (len(scales) - 3, 3)) * scales
        forces[-3:] = np.hypot(forces[-3:], self._push)
        result: Array = (inputs * forces**2) @ inputs.mT
        return result

    def variances(self, arms: IntArray) -> Array:
        """Gives the variances (r, m) of the errors of readings of arms (r,)."""
        spread = self._matrix @ self.covariance[arms] @ self._matrix.T
        return np.diagonal(spread, axis1=1, axis2=2) + self._variances

    def gains(self, arms: IntArray, states: Array, torques: Array) -> Array:
        """Gives the gains (r, 2 d, m) of arms (r,) for the errors of readings, and moves on by a period."""
        turned = (
            np.abs(states - self._designed[arms])[:, : len(self._jacobians.scales) - 3].max(axis=1)
            > RELINEARISATION_ANGLE
        )
        if turned.any():
            self._linearise(arms[turned], states[turned], torques[turned])
        result, covariance = measurement_update(self.covariance[arms], self._matrix, self._variances)
        self.covariance[arms] = time_update(covariance, self._transition[arms], self._noise[arms])
        return result


SQUARE_FORGETTING, MEAN_FORGETTING = 0.1, 0.02  # parts of the last errors in their means
SQUARE_THRESHOLD, MEAN_THRESHOLD = (
    1.45,
    5.5,
)  # mean square above 1, in deviations that a period has; mean, in deviations of its own
MAX_MISFIT = 20.0  # mean square that nothing explains


class ChangeDetector:
    """Means of the errors of readings of b arms, in their deviations.

    A sudden change shows in the mean square, a slow one in the mean of one reading (Gustafsson, Adaptive Filtering and
    Change Detection, 2000, chapter 3).

    Args:
        readings: m, how many there are.

    Attributes:
        misfit: (b,) mean square, 1 where all is as it was assumed.
    """

    state_fields = ("misfit", "_mean")

    def __init__(self, readings: int) -> None:
        self.misfit, self._mean = np.zeros(0), np.zeros((0, readings))

    def reset(self, arms: IntArray, count: int) -> None:
        """Forgets the errors of the arms (r,)."""
        self.misfit, self._mean = pad_rows(self.misfit, count), pad_rows(self._mean, count)
        self.misfit[arms], self._mean[arms] = 1.0, 0.0

    def update(self, arms: IntArray, errors: Array) -> None:
        """Takes the last errors (r, m) of arms (r,)."""
        self.misfit[arms] += SQUARE_FORGETTING * ((errors**2).mean(axis=1) - self.misfit[arms])
        self._mean[arms] += MEAN_FORGETTING * (errors - self._mean[arms])

    def detect(self, arms: IntArray) -> BoolArray:
        """Says which of the arms (r,) have errors that noise does not explain."""
        drift = np.abs(self._mean[arms]).max(axis=1) / np.sqrt(MEAN_FORGETTING / (2.0 - MEAN_FORGETTING))
        square = (self.misfit[arms] - 1.0) / np.sqrt(2.0 / self._mean.shape[1])
        result: BoolArray = (square > SQUARE_THRESHOLD) | (drift > MEAN_THRESHOLD)
        return result

    @property
    def inconsistent(self) -> BoolArray:
        """Which arms (b,) have errors, or none that are numbers, that nothing explains."""
        result: BoolArray = ~(self.misfit < MAX_MISFIT)
        return result
