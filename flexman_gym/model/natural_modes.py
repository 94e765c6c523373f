"""Natural modes of a mass and a stiffness matrix, and the error for arms beyond double precision."""

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import check_solvable

SHIFT = 1e-9  # of the largest square, added before the factorisation, so that an arm that turns freely has one
VANISHING = 1e-10  # of the shift: a square below that is rounding
TRIES = 6


def natural_modes(mass: Array, stiffness: Array) -> tuple[Array, Array]:
    """Gives squares of natural frequencies (d,) in rad^2/s^2, ascending, and shapes (d, d) with shapes^T M shapes = 1.

    An eigenvalue solver errs by parts of the largest square, which finite elements make huge. The singular values of
    L_M^T L_K^-T, of the Cholesky factors, are inverse frequencies, each of them exact to parts of the lowest frequency
    over the largest. Squares may be negative where the arm falls over.

    Args:
        mass: (d, d), positive definite.
        stiffness: (d, d), symmetric.

    Raises:
        ValueError: where rounding leaves no such factors.
    """
    from scipy.linalg import cholesky, solve_triangular, svd

    scale = np.sqrt(np.diag(mass))
    scaled, own = mass / np.outer(scale, scale), stiffness / np.outer(scale, scale)
    shift = SHIFT * max(np.abs(np.diag(own)).max(initial=0.0), 1e-6)
    with check_solvable("natural modes"):
        inertia = cholesky(scaled, lower=True)
        for _ in range(TRIES):
            try:
                factor = cholesky(own + shift * scaled, lower=True)
                break
            except np.linalg.LinAlgError:
                shift *= 100.0
        else:
            raise np.linalg.LinAlgError
        left, inverse, _ = svd(solve_triangular(factor, inertia, lower=True).T)
        shapes = solve_triangular(inertia.T, left) / scale[:, None]
    squares = 1.0 / inverse**2 - shift
    squares[np.abs(squares) < VANISHING * shift] = 0.0
    order = np.argsort(squares, kind="stable")
    return squares[order], shapes[:, order]
