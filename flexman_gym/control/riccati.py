"""Riccati: how the covariance of what is not known of a linear system grows with time and shrinks with readings.

A state x (s,) follows x' = transition x + noise, and is read as matrix x + noise, once a period.
"""

import numpy as np

from flexman_gym.arrays import Array

DOUBLINGS = 20  # a million periods
SETTLED = 1e-6  # part by which the last doubling may still change a variance


def predicted(covariance: Array, transition: Array, noise: Array) -> Array:
    """Gives covariances (..., s, s) a period later; noise (..., s, s) is the covariance of what came in it."""
    return _even(transition @ covariance @ transition.mT + noise)


def corrected(covariance: Array, matrix: Array, variances: Array) -> tuple[Array, Array]:
    """Gives the gains (..., s, m) for the errors of readings, and the covariances (..., s, s) with them.

    Kalman, Journal of Basic Engineering 82 (1960), 35, in the form of Joseph, which rounding leaves positive.

    Args:
        covariance: (..., s, s) before the readings.
        matrix: (m, s) of the readings by the state.
        variances: (m,) of the noise of readings.
    """
    across = matrix @ covariance
    gain: Array = np.asarray(np.linalg.solve(across @ matrix.T + np.diag(variances), across), dtype=float).mT
    left = np.eye(matrix.shape[1]) - gain @ matrix
    return gain, _even(left @ covariance @ left.mT + (gain * variances) @ gain.mT)


def stationary(transition: Array, noise: Array, matrix: Array, variances: Array) -> Array:
    """Gives the covariances (..., s, s) before the readings of a period to which many periods lead.

    By doubling: each pass goes on by as many periods as there have been, which needs no eigenvalues (Anderson,
    International Journal of Control 28, 1978, 295). Arguments are those of `predicted` and `corrected`. Entries of what
    the readings do not tell are infinite.
    """
    passing, told, result = transition.mT, (matrix.T / variances) @ matrix, noise
    before, eye = result, np.eye(matrix.shape[1])
    for _ in range(DOUBLINGS):
        before = result
        through = np.linalg.solve(
            eye + told @ result, np.concatenate([passing, np.broadcast_to(told, passing.shape)], -1)
        )
        size = len(eye)
        onward, spread = through[..., :size], through[..., size:]
        result = _even(result + passing.mT @ result @ onward)
        told, passing = _even(told + passing @ spread @ passing.mT), passing @ onward
    now, earlier = (np.diagonal(each, axis1=-2, axis2=-1) for each in (result, before))
    unknown = now > (1.0 + SETTLED) * earlier
    return np.where(unknown[..., None] | unknown[..., None, :], np.inf, result)


def _even(matrix: Array) -> Array:
    """The symmetric part."""
    result: Array = 0.5 * (matrix + matrix.mT)
    return result
