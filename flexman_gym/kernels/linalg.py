"""Small linear algebra for the kernels, on tuples: vectors are three numbers, matrices nine, by rows.

Tuples live in registers; the compiler need not assume that a store into one array changes another.
"""

import math

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.lanes import below, choose_below, fused

ZERO = (0.0, 0.0, 0.0)
ZERO_MATRIX = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@inner
def load(rows, i):
    """The first three numbers of row i."""
    return rows[i, 0], rows[i, 1], rows[i, 2]


@inner
def load_pair(rows, i):
    """Row i, six numbers, as linear and angular part."""
    return (rows[i, 0], rows[i, 1], rows[i, 2]), (rows[i, 3], rows[i, 4], rows[i, 5])


@inner
def load_matrix(flat, i):
    """The i-th nine numbers of a flat array."""
    j = 9 * i
    return (
        flat[j], flat[j + 1], flat[j + 2], flat[j + 3], flat[j + 4], flat[j + 5], flat[j + 6], flat[j + 7], flat[j + 8],
    )  # fmt: skip


@inner
def store(rows, i, a):
    """rows[i, :3] = a."""
    rows[i, 0], rows[i, 1], rows[i, 2] = a


@inner
def store_pair(rows, i, linear, angular):
    """rows[i] = linear and angular part."""
    rows[i, 0], rows[i, 1], rows[i, 2] = linear
    rows[i, 3], rows[i, 4], rows[i, 5] = angular


@inner
def store_matrix(flat, i, a):
    """The i-th nine numbers of a flat array = a."""
    for j in range(9):
        flat[9 * i + j] = a[j]


@inner
def copy(source, target):
    """target[:] = source, of equal length; a slice on the left would allocate."""
    for j in range(len(source)):
        target[j] = source[j]


@inner
def add(a, b):
    """a + b of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inner
def add_scaled(a, factor, b):
    """a + factor b of two vectors."""
    return fused(factor, b[0], a[0]), fused(factor, b[1], a[1]), fused(factor, b[2], a[2])


@inner
def dot(a, b):
    """Scalar product of two vectors."""
    return fused(a[0], b[0], fused(a[1], b[1], a[2] * b[2]))


@inner
def cross(a, b):
    """Cross product of two vectors."""
    return fused(a[1], b[2], -a[2] * b[1]), fused(a[2], b[0], -a[0] * b[2]), fused(a[0], b[1], -a[1] * b[0])


@inner
def apply(matrix, a):
    """Matrix times vector."""
    return (
        fused(matrix[0], a[0], fused(matrix[1], a[1], matrix[2] * a[2])),
        fused(matrix[3], a[0], fused(matrix[4], a[1], matrix[5] * a[2])),
        fused(matrix[6], a[0], fused(matrix[7], a[1], matrix[8] * a[2])),
    )


@inner
def apply_back(matrix, a):
    """Transposed matrix times vector."""
    return (
        fused(matrix[0], a[0], fused(matrix[3], a[1], matrix[6] * a[2])),
        fused(matrix[1], a[0], fused(matrix[4], a[1], matrix[7] * a[2])),
        fused(matrix[2], a[0], fused(matrix[5], a[1], matrix[8] * a[2])),
    )


@inner
def transposed(a):
    """Transpose of a matrix."""
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


@inner
def add_matrix(a, factor, b):
    """a + factor b of two matrices."""
    return (
        fused(factor, b[0], a[0]), fused(factor, b[1], a[1]), fused(factor, b[2], a[2]),
        fused(factor, b[3], a[3]), fused(factor, b[4], a[4]), fused(factor, b[5], a[5]),
        fused(factor, b[6], a[6]), fused(factor, b[7], a[7]), fused(factor, b[8], a[8]),
    )  # fmt: skip


@inner
def subtract_outer(a, b, c):
    """a - b c^T of a matrix and two vectors."""
    return (
        fused(-b[0], c[0], a[0]), fused(-b[0], c[1], a[1]), fused(-b[0], c[2], a[2]),
        fused(-b[1], c[0], a[3]), fused(-b[1], c[1], a[4]), fused(-b[1], c[2], a[5]),
        fused(-b[2], c[0], a[6]), fused(-b[2], c[1], a[7]), fused(-b[2], c[2], a[8]),
    )  # fmt: skip


@inner
def product(a, b):
    """Product of two matrices."""
    return (
        fused(a[0], b[0], fused(a[1], b[3], a[2] * b[6])),
        fused(a[0], b[1], fused(a[1], b[4], a[2] * b[7])),
        fused(a[0], b[2], fused(a[1], b[5], a[2] * b[8])),
        fused(a[3], b[0], fused(a[4], b[3], a[5] * b[6])),
        fused(a[3], b[1], fused(a[4], b[4], a[5] * b[7])),
        fused(a[3], b[2], fused(a[4], b[5], a[5] * b[8])),
        fused(a[6], b[0], fused(a[7], b[3], a[8] * b[6])),
        fused(a[6], b[1], fused(a[7], b[4], a[8] * b[7])),
        fused(a[6], b[2], fused(a[7], b[5], a[8] * b[8])),
    )


@inner
def product_skew(a, d):
    """Matrix times the skew matrix of d: its rows crossed with d."""
    return (
        fused(a[1], d[2], -a[2] * d[1]), fused(a[2], d[0], -a[0] * d[2]), fused(a[0], d[1], -a[1] * d[0]),
        fused(a[4], d[2], -a[5] * d[1]), fused(a[5], d[0], -a[3] * d[2]), fused(a[3], d[1], -a[4] * d[0]),
        fused(a[7], d[2], -a[8] * d[1]), fused(a[8], d[0], -a[6] * d[2]), fused(a[6], d[1], -a[7] * d[0]),
    )  # fmt: skip


@inner
def apply_inertia(inertia, acceleration):
    """Force and moment for a linear and angular acceleration; an inertia is a triple, see `dynamics`."""
    linear, angular = acceleration
    force, mixed, moment = inertia
    return add(apply(force, linear), apply(mixed, angular)), add(apply_back(mixed, linear), apply(moment, angular))


@inner
def rotation_matrix(sine, versine, v):
    """I + sine X + versine X^2, X the skew matrix of the vector v."""
    x, y, z = v
    return (
        1.0 - versine * (y * y + z * z), versine * x * y - sine * z, versine * x * z + sine * y,
        versine * x * y + sine * z, 1.0 - versine * (x * x + z * z), versine * y * z - sine * x,
        versine * x * z - sine * y, versine * y * z + sine * x, 1.0 - versine * (x * x + y * y),
    )  # fmt: skip


@inner
def tangent_coefficients(z):
    """(1 - cos p)/p^2, (p - sin p)/p^3 and their derivatives with respect to z = p^2."""
    # Taylor series to rounding: the quotients below lose all digits at zero
    b = 1 / 2 - z * (1 / 24 - z * (1 / 720 - z * (1 / 40320 - z * (1 / 3628800 - z * (1 / 479001600)))))
    c = 1 / 6 - z * (1 / 120 - z * (1 / 5040 - z * (1 / 362880 - z * (1 / 39916800 - z * (1 / 6227020800)))))
    db = -1 / 24 + z * (1 / 360 - z * (1 / 13440 - z * (1 / 907200 - z * (1 / 95800320 - z * (1 / 14529715200)))))
    dc = 1 / 120960 - z * (1 / 9979200 - z * (1 / 1245404160 - z * (1 / 217945728000)))
    dc = -1 / 120 + z * (1 / 2520 - z * dc)
    if below(z, 0.25):
        return b, c, db, dc
    p = math.sqrt(z)
    s = math.sin(p) / p
    far_b = (1.0 - math.cos(p)) / z
    far_c = (1.0 - s) / z
    far_db, far_dc = (s - 2.0 * far_b) / (2.0 * z), (far_b - 3.0 * far_c) / (2.0 * z)
    return (
        choose_below(z, 0.25, b, far_b), choose_below(z, 0.25, c, far_c),
        choose_below(z, 0.25, db, far_db), choose_below(z, 0.25, dc, far_dc),
    )  # fmt: skip
