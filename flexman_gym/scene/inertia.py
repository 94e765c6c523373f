"""Inertia: that of a rigid body, checked."""

from typing import Any

import numpy as np

from flexman_gym.arrays import Matrix, Vector
from flexman_gym.checks import MOST, bounded, refusal, sequence, vector


def body(name: str, inertia: Matrix | None, offset: Vector | None) -> dict[str, Any]:
    """Gives the inertia and the offset of a rigid body as they are stored; None stays None.

    Raises:
        ValueError: for an inertia that no rigid body has, and for an offset that is not three numbers up to 1e30.
    """
    if inertia is not None:
        inertia = inertia_matrix(f"{name}.inertia", inertia)
    if offset is not None:
        offset = vector(f"{name}.offset", offset, 3, "m")
        bounded(f"{name}.offset", offset, MOST, "m")
    return {"inertia": inertia, "offset": offset}


def inertia_matrix(name: str, value: object) -> tuple[tuple[float, ...], ...]:
    """Gives the (3, 3) inertia of a rigid body in kg m^2 as a tuple of rows.

    It is symmetric, its principal moments are not negative, and none exceeds the sum of the other two.

    Raises:
        ValueError: for anything else.
    """
    allowed = "a symmetric inertia (kg m^2) whose principal moments are >= 0, none above the sum of the others"
    rows = sequence(name, value, "3 rows of 3 numbers")
    if len(rows) != 3:
        raise refusal(name, value, "3 rows of 3 numbers")
    rows = tuple(vector(f"{name}[{i}]", row, 3) for i, row in enumerate(rows))
    matrix = np.array(rows)
    if not np.array_equal(matrix, matrix.T):
        raise refusal(name, value, allowed)
    moments = np.linalg.eigvalsh(matrix)
    rounding = 1e-12 * max(abs(moments))
    if moments[0] < -rounding or moments[2] > moments[0] + moments[1] + rounding:
        raise refusal(name, value, allowed)
    return rows
