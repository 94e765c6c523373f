"""Undamped natural modes of a mass and a stiffness matrix, accurate for the low frequencies of stiff systems."""

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import check_solvable

SHIFT = 1e-9  # spectral shift / largest scaled stiffness; it makes K positive definite despite rigid-body modes
ZERO_SQUARE = 1e-10  # dimensionless; squared frequency / shift, below which the frequency is a rounded zero
MAX_SHIFTS = 6  # number of attempts, each with a shift 100 times as large as the last


def natural_modes(mass: Array, stiffness: Array) -> tuple[Array, Array]:
    """Return squared natural frequencies (d,) in rad^2/s^2, ascending, and mass-normalised mode shapes (d, d).

    The error of a general eigenvalue solver is proportional to the largest squared frequency, which is huge for finite
    elements. Here the inverse frequencies are the singular values of L_M^T L_K^-T, with the Cholesky factors L_M and
    L_K of mass and stiffness, so that the lowest frequencies are the most accurate. Squared frequencies are negative
    where gravity makes the equilibrium unstable.

    Args:
        mass: mass matrix (d, d), positive definite, in SI units.
        stiffness: stiffness matrix (d, d), symmetric, in SI units.

    Returns:
        Squared frequencies, and shapes as columns with shapes^T M shapes = 1.

    Raises:
        ValueError: for matrices without Cholesky factors in double precision.
    """
    from scipy.linalg import cholesky, solve_triangular, svd

    scale = np.sqrt(np.diag(mass))
    scaled_mass, scaled_stiffness = mass / np.outer(scale, scale), stiffness / np.outer(scale, scale)
    shift = SHIFT * max(np.abs(np.diag(scaled_stiffness)).max(initial=0.0), 1e-6)
    with check_solvable("natural modes"):
        mass_factor = cholesky(scaled_mass, lower=True)
        for _ in range(MAX_SHIFTS):
            try:
                stiffness_factor = cholesky(scaled_stiffness + shift * scaled_mass, lower=True)
                break
            except np.linalg.LinAlgError:
                shift *= 100.0
        else:
            raise np.linalg.LinAlgError
        left, inverse_frequencies, _ = svd(solve_triangular(stiffness_factor, mass_factor, lower=True).T)
        shapes = solve_triangular(mass_factor.T, left) / scale[:, None]
    squares = 1.0 / inverse_frequencies**2 - shift
    squares[np.abs(squares) < ZERO_SQUARE * shift] = 0.0
    order = np.argsort(squares, kind="stable")
    return squares[order], shapes[:, order]
