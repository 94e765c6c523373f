"""Innovations: gains by which readings correct simulated arms that something pushes, and how exact they then are."""

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray, grown
from flexman_gym.control.instruments import Instruments
from flexman_gym.control.riccati import corrected, predicted, stationary
from flexman_gym.control.slopes import Slopes

QUIETLY, SUDDENLY = (0.001, 0.002), (0.02, 0.1)  # torques and forces on the tip that push, parts of their scales
TURNED = 0.3  # rad by which an arm has turned when its motion is linearised anew


class Innovations:
    """Kalman gains of b arms for the errors of their readings, with the linear motion about where an arm is.

    Args:
        slopes: of the arm.
        instruments: what is read of it.
        push: N, how large forces on the tip may be at any time.
    """

    kept = ("covariance", "_transition", "_noise", "_designed")

    def __init__(self, slopes: Slopes, instruments: Instruments, push: float) -> None:
        self._slopes, self._matrix, self._push = slopes, instruments.matrix, push
        self._variances, size = instruments.deviations**2, instruments.matrix.shape[1]
        self.covariance, self._transition, self._noise = (np.zeros((0, size, size)) for _ in range(3))
        self._designed = np.zeros((0, size))

    def grow(self, count: int) -> None:
        """Makes room for so many arms."""
        for name in self.kept:
            setattr(self, name, grown(getattr(self, name), count))

    def begin(self, arms: IntArray, states: Array, torques: Array, sudden: bool) -> Flags:
        """Begins for arms (r,) at states (r, 2 d) under torques (r, n) N m; says for which of them it can.

        Args:
            arms: (r,).
            states: as they are estimated.
            torques: that act.
            sudden: whether something has just pushed them, so that the estimate is not exact.
        """
        inputs, well = self._linearise(arms, states, torques)
        noise = self._noise[arms] + sudden * self._noise_of(inputs, SUDDENLY)
        covariance = stationary(self._transition[arms], noise, self._matrix, self._variances)
        result: Flags = well & np.isfinite(covariance).all(axis=(1, 2))
        self.covariance[arms[result]] = covariance[result]
        return result

    def _linearise(self, arms: IntArray, states: Array, torques: Array) -> tuple[Array, Flags]:
        """Takes the slopes of the motion of arms (r,); gives those by forces, and says where they are good."""
        slopes, good = self._slopes(states, torques)
        some, inputs = arms[good], slopes[..., states.shape[1] :]
        self._transition[some] = slopes[good][..., : states.shape[1]]
        self._noise[some] = self._noise_of(inputs[good], QUIETLY)
        self._designed[some] = states[good]
        return inputs, good

    def _noise_of(self, inputs: Array, parts: tuple[float, float]) -> Array:
        """The covariance (r, 2 d, 2 d) of what forces, parts of their scales, add in a period."""
        scales = self._slopes.scales
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
        turned = np.abs(states - self._designed[arms])[:, : len(self._slopes.scales) - 3].max(axis=1) > TURNED
        if turned.any():
            self._linearise(arms[turned], states[turned], torques[turned])
        result, covariance = corrected(self.covariance[arms], self._matrix, self._variances)
        self.covariance[arms] = predicted(covariance, self._transition[arms], self._noise[arms])
        return result
