"""Arrays: the aliases of the array types that rooms above the kernels share."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]
Vector = Sequence[float] | NDArray[Any]  # what a person may give where numbers are wanted
Matrix = Sequence[Sequence[float]] | NDArray[Any]
