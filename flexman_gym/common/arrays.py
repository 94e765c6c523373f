"""Array types, and row products whose bits do not depend on the number of rows."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Vector = Sequence[float] | NDArray[Any]  # what a person may give where numbers are wanted
Matrix = Sequence[Sequence[float]] | NDArray[Any]


def pad_rows(values: NDArray[Any], count: int) -> NDArray[Any]:
    """Gives the values with as many rows as arms, new ones zero."""
    if count <= len(values):
        return values
    return np.concatenate([values, np.zeros((count - len(values), *values.shape[1:]), dtype=values.dtype)])


def row_dots(left: NDArray[Any], right: NDArray[Any]) -> Any:
    """Gives the scalar products (...) of rows (..., k), each to the bits that it has alone.

    `np.vecdot` does not: it is a product of BLAS, whose last digits depend on where in memory a row begins.
    """
    return np.multiply(left, right, order="C").sum(axis=-1)
