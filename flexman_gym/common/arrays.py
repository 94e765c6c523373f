"""Array types, and row operations with results that do not depend on the number of rows, to the bit."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Vector = Sequence[float] | NDArray[Any]  # accepted wherever a vector is an argument
Matrix = Sequence[Sequence[float]] | NDArray[Any]


def pad_rows(values: NDArray[Any], count: int) -> NDArray[Any]:
    """Return values (b, ...) extended to `count` rows by rows of zeros."""
    if count <= len(values):
        return values
    return np.concatenate([values, np.zeros((count - len(values), *values.shape[1:]), dtype=values.dtype)])


def row_dots(left: NDArray[Any], right: NDArray[Any]) -> Any:
    """Return the scalar products (...) of rows (..., k), to the bit independent of the number of rows.

    `np.vecdot` calls BLAS, whose last digits depend on the memory address of a row.
    """
    return np.multiply(left, right, order="C").sum(axis=-1)
