"""Inertia: that of a rigid body, checked."""

import numpy as np

from flexman_gym.checks import refusal, sequence, vector


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
