"""Innovations: Kalman gains for the correction of simulated arms, and change detection."""

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows
from flexman_gym.toolbox.controllers.internal_model import DiscreteJacobians
from flexman_gym.toolbox.controllers.observers.kalman_filter import (
    measurement_update,
    stationary_covariance,
    time_update,
)
from flexman_gym.toolbox.controllers.observers.observer import MeasurementModel

# Fractions of the force scales; standard deviations of random torques and tip forces
PROCESS_NOISE = (0.1, 0.02)  # of an arm whose measurements its model does not explain
SMALL_PROCESS_NOISE = (0.0001, 0.0002)  # of an arm whose measurements its model explains
CHANGE_NOISE = (0.02, 0.1)  # fractions of the force scales; standard deviations added after a detected change
RELINEARISATION_ANGLE = 0.3  # rad; change of a joint or motor angle after which the dynamics are linearised again


class InnovationGains:
    """Kalman gains of b arms for their innovations, with the discrete dynamics linearised about the current states.

    Args:
        jacobians: Jacobians of the discrete dynamics.
        instruments: measurement model.
        tip_force: magnitude of unmeasured forces on the tip, N.
    """

    state_fields = ("covariance", "_transition", "_noise", "_designed", "_fractions")

    def __init__(self, jacobians: DiscreteJacobians, instruments: MeasurementModel, tip_force: float) -> None:
        self._jacobians, self._matrix, self._tip_force = jacobians, instruments.matrix, tip_force
        self._variances, size = instruments.deviations**2, instruments.matrix.shape[1]
        self.covariance, self._transition, self._noise = (np.zeros((0, size, size)) for _ in range(3))
        self._designed, self._fractions = np.zeros((0, size)), np.zeros((0, 2))

    def allocate(self, count: int) -> None:
        """Allocate memory for `count` arms."""
        for name in self.state_fields:
            setattr(self, name, pad_rows(getattr(self, name), count))

    def begin(
        self, arms: IntArray, states: Array, torques: Array, fractions: tuple[float, float], sudden: bool = False
    ) -> BoolArray:
        """Initialise the covariance of arms (r,) with the stationary one; return flags (r,) of arms where it exists.

        Args:
            arms: (r,) indices.
            states: (r, 2 d) estimated states.
            torques: (r, n) applied torques, N m.
            fractions: process noise, see PROCESS_NOISE.
            sudden: True after a detected abrupt change, when the estimate is inaccurate.
        """
        self._fractions[arms] = fractions
        inputs, valid = self._linearise(arms, states, torques)
        noise = self._noise[arms] + sudden * self._process_noise(inputs, np.array([CHANGE_NOISE]))
        covariance = stationary_covariance(self._transition[arms], noise, self._matrix, self._variances)
        result: BoolArray = valid & np.isfinite(covariance).all(axis=(1, 2))
        self.covariance[arms[result]] = covariance[result]
        return result

    def _linearise(self, arms: IntArray, states: Array, torques: Array) -> tuple[Array, BoolArray]:
        """Store the linearised dynamics of arms (r,); return input Jacobians (r, 2 d, n + 3) and flags (r,)."""
        jacobians, valid = self._jacobians(states, torques)
        updated, inputs = arms[valid], jacobians[..., states.shape[1] :]
        self._transition[updated] = jacobians[valid][..., : states.shape[1]]
        self._noise[updated] = self._process_noise(inputs[valid], self._fractions[updated])
        self._designed[updated] = states[valid]
        return inputs, valid

    def _process_noise(self, inputs: Array, fractions: Array) -> Array:
        """Return the covariance (r, 2 d, 2 d) of random torques and tip forces, given as fractions (r or 1, 2)."""
        scales = self._jacobians.scales
        forces = np.repeat(fractions, (len(scales) - 3, 3), axis=1) * scales
        forces[:, -3:] = np.hypot(forces[:, -3:], self._tip_force)
        result: Array = (inputs * forces[:, None] ** 2) @ inputs.mT
        return result

    def propagate(self, arms: IntArray, sensitivities: Array) -> Array:
        """Return the sensitivities (r, 2 d, e) of the states of arms (r,) to e constants, a period later."""
        result: Array = self._transition[arms] @ sensitivities
        return result

    def variances(self, arms: IntArray) -> Array:
        """Return the variances (r, m) of the innovations of arms (r,)."""
        covariance = self._matrix @ self.covariance[arms] @ self._matrix.T
        return np.diagonal(covariance, axis1=1, axis2=2) + self._variances

    def gains(self, arms: IntArray, states: Array, torques: Array) -> Array:
        """Return the gains (r, 2 d, m) of arms (r,), and advance their covariances by a period."""
        changes = np.abs(states - self._designed[arms])[:, : len(self._jacobians.scales) - 3]
        due = changes.max(axis=1) > RELINEARISATION_ANGLE
        if due.any():
            self._linearise(arms[due], states[due], torques[due])
        result, covariance = measurement_update(self.covariance[arms], self._matrix, self._variances)
        self.covariance[arms] = time_update(covariance, self._transition[arms], self._noise[arms])
        return result


SQUARE_FORGETTING = 0.1  # dimensionless; weight of the latest innovation in the mean square
MEAN_FORGETTING = 0.02  # dimensionless; weight of the latest innovation in the mean
SQUARE_THRESHOLD = 1.45  # standard deviations; mean square minus 1 above which a change is detected
MEAN_THRESHOLD = 5.5  # standard deviations; mean innovation above which a change is detected
MAX_MISFIT = 20.0  # dimensionless; mean square above which no model explains the measurements


class ChangeDetector:
    """Change detection for b arms from moving averages of their normalised innovations.

    An abrupt change shows in the mean square, a slow change in the mean of one innovation (Gustafsson, Adaptive
    Filtering and Change Detection, 2000, chapter 3).

    Args:
        readings: m, number of measurements.

    Attributes:
        misfit: (b,) mean square of the normalised innovations; 1 if the model is correct.
    """

    state_fields = ("misfit", "_mean")

    def __init__(self, readings: int) -> None:
        self.misfit, self._mean = np.zeros(0), np.zeros((0, readings))

    def reset(self, arms: IntArray, count: int) -> None:
        """Reset the moving averages of the arms with indices (r,); `count` is the total number of arms."""
        self.misfit, self._mean = pad_rows(self.misfit, count), pad_rows(self._mean, count)
        self.misfit[arms], self._mean[arms] = 1.0, 0.0

    def update(self, arms: IntArray, errors: Array) -> None:
        """Add the latest normalised innovations (r, m) of arms (r,)."""
        self.misfit[arms] += SQUARE_FORGETTING * ((errors**2).mean(axis=1) - self.misfit[arms])
        self._mean[arms] += MEAN_FORGETTING * (errors - self._mean[arms])

    def detect(self, arms: IntArray) -> BoolArray:
        """Return flags (r,) of the arms (r,) with innovations beyond the noise."""
        bias = np.abs(self._mean[arms]).max(axis=1) / np.sqrt(MEAN_FORGETTING / (2.0 - MEAN_FORGETTING))
        square = (self.misfit[arms] - 1.0) / np.sqrt(2.0 / self._mean.shape[1])
        result: BoolArray = (square > SQUARE_THRESHOLD) | (bias > MEAN_THRESHOLD)
        return result

    @property
    def inconsistent(self) -> BoolArray:
        """Flags (b,) of arms with innovations that no model explains, or that are not finite."""
        result: BoolArray = ~(self.misfit < MAX_MISFIT)
        return result
