"""Kinds of methods, checks of their coefficients, and amplification matrices of the test problem."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import instance
from flexman_gym.kernels.layout import MAX_STAGES

EXPLICIT, LINEARLY_IMPLICIT, IMPLICIT, REFERENCE = "explicit", "linearly implicit", "implicit", "reference"
KINDS = (EXPLICIT, LINEARLY_IMPLICIT, IMPLICIT, REFERENCE)
ORDER_TOLERANCE = 1e-12  # dimensionless; largest residual of an order condition: rounding of its sum


def no_error_weights() -> Array:
    """Return the weights (0, 0) of no error estimate."""
    return np.zeros((0, 0))


def check_stages(name: str, a: Array, b: Array, error: Array) -> None:
    """Raise a ValueError for coefficients (s, s), (s,) and (e, s + 1) that do not fit each other."""
    for part, value in (("a", a), ("b", b), ("error", error)):
        instance(f"{name}.{part}", value, np.ndarray, "an array")
    s = len(b)
    if a.shape != (s, s) or np.triu(a).any() or not 0 < s < MAX_STAGES:
        raise ValueError(f"{name}: a must be strictly lower triangular, {s} x {s}, with 0 < s < {MAX_STAGES}")
    if error.size and error.shape not in ((1, s + 1), (2, s + 1)):
        raise ValueError(f"{name}: error must be 1 or 2 rows of weights, one for each of {s} stages")


def check_order(name: str, order: int, conditions: list[tuple[int, str, float]]) -> None:
    """Raise a ValueError for order conditions (order, name, residual) that do not hold."""
    for least, condition, residual in conditions:
        if least <= order and not abs(residual) <= ORDER_TOLERANCE:
            raise ValueError(f"{name}: is not of order {order}: {condition} is off by {residual:.3g}")


def stability_function(matrix: Array, b: Array, z: np.ndarray) -> np.ndarray:
    """Return R(z), the factor of a step of length 1 of a Runge-Kutta method for y' = z y."""
    size = len(b)
    stages = np.linalg.solve(np.eye(size) - z[..., None, None] * matrix, np.ones((*z.shape, size, 1)))
    return 1.0 + z * (stages[..., 0] @ b)


def matrices(rows: list[list[Any]]) -> Array:
    """Return matrices (..., f, f) from rows of numbers or arrays (...)."""
    entries = np.broadcast_arrays(*(entry for row in rows for entry in row))
    return np.stack(entries, axis=-1).reshape(*entries[0].shape, len(rows), len(rows))


def eigenvalues(matrix: np.ndarray) -> NDArray[np.complex128]:
    """Return the eigenvalues (..., f) of matrices (..., f, f)."""
    return np.linalg.eigvals(matrix).astype(np.complex128)


def lower_triangular(size: int, rows: Sequence[Sequence[float]]) -> Array:
    """Return a matrix (size, size) with given entries below its diagonal."""
    matrix = np.zeros((size, size))
    for i, row in enumerate(rows, start=1):
        matrix[i, : len(row)] = row
    return matrix
