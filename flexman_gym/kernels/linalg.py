"""Small linear algebra for the kernels: vectors as scalars, rotations, six by six inertias."""

import math

import numba

# reassoc lets short sums use vector lanes; nnan and ninf stay off, they would remove the test for divergence.
FLAGS = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"}}
kernel = numba.njit(**FLAGS)
inner = numba.njit(**FLAGS, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)


@inner
def cross(a, b):
    """Cross product of two three-tuples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner
def load(rows, i):
    """The first three numbers of row i as a tuple."""
    return rows[i, 0], rows[i, 1], rows[i, 2]


@inner
def load_linear_angular(rows, i):
    """Row i, six numbers, as two three-tuples."""
    return (rows[i, 0], rows[i, 1], rows[i, 2]), (rows[i, 3], rows[i, 4], rows[i, 5])


@inner
def rotate(rotations, i, a):
    """rotations[i] @ a as a tuple."""
    return (
        rotations[i, 0, 0] * a[0] + rotations[i, 0, 1] * a[1] + rotations[i, 0, 2] * a[2],
        rotations[i, 1, 0] * a[0] + rotations[i, 1, 1] * a[1] + rotations[i, 1, 2] * a[2],
        rotations[i, 2, 0] * a[0] + rotations[i, 2, 1] * a[1] + rotations[i, 2, 2] * a[2],
    )


@inner
def rotate_back(rotations, i, a):
    """rotations[i].T @ a as a tuple."""
    return (
        rotations[i, 0, 0] * a[0] + rotations[i, 1, 0] * a[1] + rotations[i, 2, 0] * a[2],
        rotations[i, 0, 1] * a[0] + rotations[i, 1, 1] * a[1] + rotations[i, 2, 1] * a[2],
        rotations[i, 0, 2] * a[0] + rotations[i, 1, 2] * a[1] + rotations[i, 2, 2] * a[2],
    )


@inner
def rotation_matrix(sine, versine, v):
    """I + sine X + versine X^2 as nine numbers by rows, X the skew matrix of the three-tuple v."""
    x, y, z = v
    return (
        1.0 - versine * (y * y + z * z), versine * x * y - sine * z, versine * x * z + sine * y,
        versine * x * y + sine * z, 1.0 - versine * (x * x + z * z), versine * y * z - sine * x,
        versine * x * z - sine * y, versine * y * z + sine * x, 1.0 - versine * (x * x + y * y),
    )  # fmt: skip


@inner
def product(a, b):
    """Product of two 3x3 matrices given and returned as nine numbers by rows."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@inner
def tangent_coefficients(z):
    """(1 - cos p)/p^2, (p - sin p)/p^3 and their derivatives with respect to z = p^2."""
    if z < 1.0:
        # The series are exact to rounding here, and finite at zero.
        b = c = db = dc = 0.0
        term = 0.5
        for j in range(10):
            b += term
            db += -term * (j + 1) / ((2 * j + 3) * (2 * j + 4))
            c += term / (2 * j + 3)
            dc += -term * (j + 1) / ((2 * j + 3) * (2 * j + 4) * (2 * j + 5))
            term *= -z / ((2 * j + 3) * (2 * j + 4))
        return b, c, db, dc
    p = math.sqrt(z)
    b = (1.0 - math.cos(p)) / z
    s = math.sin(p) / p
    c = (1.0 - s) / z
    return b, c, (s - 2.0 * b) / (2.0 * z), (b - 3.0 * c) / (2.0 * z)


@inner
def rotate_inertia(inertias, i, rotations, out):
    """out = C inertias[i] C^T for both halves of a symmetric (6, 6) inertia, C = rotations[i]."""
    c = rotations[i]
    source = inertias[i]
    for block in range(3):
        row, column = 3 * (block // 2), 3 * ((block + 1) // 2)
        for j in range(3):
            first = source[row, column] * c[j, 0] + source[row, column + 1] * c[j, 1] + source[row, column + 2] * c[j, 2]
            second = (
                source[row + 1, column] * c[j, 0]
                + source[row + 1, column + 1] * c[j, 1]
                + source[row + 1, column + 2] * c[j, 2]
            )
            third = (
                source[row + 2, column] * c[j, 0]
                + source[row + 2, column + 1] * c[j, 1]
                + source[row + 2, column + 2] * c[j, 2]
            )
            for k in range(3):
                value = c[k, 0] * first + c[k, 1] * second + c[k, 2] * third
                out[row + k, column + j] = value
                out[column + j, row + k] = value
