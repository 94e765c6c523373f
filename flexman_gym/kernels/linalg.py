"""Linear algebra of 3-vectors and 3 x 3 matrices as tuples (matrices by rows), sine and versine.

Tuples stay in registers, and the compiler need not assume that a store to one array changes another. `sine_versine` is
a series, equal to the bit for one arm and a batch, because the sine of the mathematical library accepts single numbers
only, took half the time of the positions of a batch, and differs between computers in the last digits.
"""

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.lanes import chain, fma, number_of

PI_HIGH, PI_LOW = 3.141592653589793, 1.2246467991473532e-16  # pi rounded to float64, and the rounding error
ROUND_TO_INTEGER = 1.5 * 2.0**52  # adding and subtracting this number rounds to an integer


@inner
def sine_versine(angle):
    """Return the sine and the versine, 1 - cosine, of an angle (rad) up to 1e6.

    Both errors are below 4e-16; small versines keep their relative accuracy.
    """
    sine, versine = _sine_versine(number_of(angle))  # rounding by addition would keep the derivative of a step function
    return chain(sine, 1.0 - versine, angle), chain(versine, sine, angle)


@inner
def _sine_versine(angle):
    """Return sine and versine of an angle without tangents."""
    turns = (angle * (1.0 / PI_HIGH) + ROUND_TO_INTEGER) - ROUND_TO_INTEGER
    odd = turns - 2.0 * ((0.5 * turns + ROUND_TO_INTEGER) - ROUND_TO_INTEGER)  # -1, 0 or 1
    odd = odd * odd
    rest = fma(-turns, PI_LOW, fma(-turns, PI_HIGH, angle))
    z = rest * rest
    # Taylor series, exact to rounding up to a quarter turn
    sine = fma(z, 1 / 51090942171709440000, -1 / 121645100408832000)
    sine = fma(z, fma(z, sine, 1 / 355687428096000), -1 / 1307674368000)
    sine = fma(z, fma(z, sine, 1 / 6227020800), -1 / 39916800)
    sine = fma(z, fma(z, sine, 1 / 362880), -1 / 5040)
    sine = fma(z, fma(z, sine, 1 / 120), -1 / 6)
    sine = fma(rest * z, sine, rest)
    versine = fma(z, 1 / 1124000727777607680000, -1 / 2432902008176640000)
    versine = fma(z, fma(z, versine, 1 / 6402373705728000), -1 / 20922789888000)
    versine = fma(z, fma(z, versine, 1 / 87178291200), -1 / 479001600)
    versine = fma(z, fma(z, versine, 1 / 3628800), -1 / 40320)
    versine = fma(z, fma(z, versine, 1 / 720), -1 / 24)
    versine = z * fma(z, versine, 0.5)
    sign = 1.0 - 2.0 * odd
    return sign * sine, fma(sign, versine, 2.0 * odd)


ZERO = (0.0, 0.0, 0.0)
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@inner
def load(rows, i):
    """Return the first three numbers of row i as a vector."""
    return rows[i, 0], rows[i, 1], rows[i, 2]


@inner
def load_pair(rows, i):
    """Return the linear and the angular part of row i, a six-vector."""
    return (rows[i, 0], rows[i, 1], rows[i, 2]), (rows[i, 3], rows[i, 4], rows[i, 5])


@inner
def load_matrix(flat, i):
    """Return matrix i, nine numbers by rows, of a flat array of matrices."""
    j = 9 * i
    return (
        flat[j], flat[j + 1], flat[j + 2], flat[j + 3], flat[j + 4], flat[j + 5], flat[j + 6], flat[j + 7], flat[j + 8],
    )  # fmt: skip


@inner
def store(rows, i, a):
    """Set the first three numbers of row i to a vector."""
    rows[i, 0], rows[i, 1], rows[i, 2] = a


@inner
def store_pair(rows, i, linear, angular):
    """Set row i, a six-vector, to a linear and an angular part."""
    rows[i, 0], rows[i, 1], rows[i, 2] = linear
    rows[i, 3], rows[i, 4], rows[i, 5] = angular


@inner
def store_matrix(flat, i, a):
    """Set matrix i of a flat array of matrices."""
    for j in range(9):
        flat[9 * i + j] = a[j]


@inner
def copy(source, target):
    """Copy a source (j,) to a target (j,); assignment to a slice would allocate memory."""
    for j in range(len(source)):
        target[j] = source[j]


@inner
def add(a, b):
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inner
def add_scaled(a, factor, b):
    """Return a + factor b of two vectors."""
    return fma(factor, b[0], a[0]), fma(factor, b[1], a[1]), fma(factor, b[2], a[2])


@inner
def dot(a, b):
    """Return the scalar product of two vectors."""
    return fma(a[0], b[0], fma(a[1], b[1], a[2] * b[2]))


@inner
def cross(a, b):
    """Return the cross product of two vectors."""
    return fma(a[1], b[2], -a[2] * b[1]), fma(a[2], b[0], -a[0] * b[2]), fma(a[0], b[1], -a[1] * b[0])


@inner
def apply(matrix, a):
    """Return the product of a matrix and a vector."""
    return (
        fma(matrix[0], a[0], fma(matrix[1], a[1], matrix[2] * a[2])),
        fma(matrix[3], a[0], fma(matrix[4], a[1], matrix[5] * a[2])),
        fma(matrix[6], a[0], fma(matrix[7], a[1], matrix[8] * a[2])),
    )


@inner
def apply_transposed(matrix, a):
    """Return the product of a transposed matrix and a vector."""
    return (
        fma(matrix[0], a[0], fma(matrix[3], a[1], matrix[6] * a[2])),
        fma(matrix[1], a[0], fma(matrix[4], a[1], matrix[7] * a[2])),
        fma(matrix[2], a[0], fma(matrix[5], a[1], matrix[8] * a[2])),
    )


@inner
def transposed(a):
    """Return the transpose of a matrix."""
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


@inner
def add_matrix(a, factor, b):
    """Return a + factor b of two matrices."""
    return (
        fma(factor, b[0], a[0]), fma(factor, b[1], a[1]), fma(factor, b[2], a[2]),
        fma(factor, b[3], a[3]), fma(factor, b[4], a[4]), fma(factor, b[5], a[5]),
        fma(factor, b[6], a[6]), fma(factor, b[7], a[7]), fma(factor, b[8], a[8]),
    )  # fmt: skip


@inner
def subtract_outer(a, b, c):
    """Return a - b c^T of a matrix and two vectors."""
    return (
        fma(-b[0], c[0], a[0]), fma(-b[0], c[1], a[1]), fma(-b[0], c[2], a[2]),
        fma(-b[1], c[0], a[3]), fma(-b[1], c[1], a[4]), fma(-b[1], c[2], a[5]),
        fma(-b[2], c[0], a[6]), fma(-b[2], c[1], a[7]), fma(-b[2], c[2], a[8]),
    )  # fmt: skip


@inner
def product(a, b):
    """Return the product of two matrices."""
    return (
        fma(a[0], b[0], fma(a[1], b[3], a[2] * b[6])),
        fma(a[0], b[1], fma(a[1], b[4], a[2] * b[7])),
        fma(a[0], b[2], fma(a[1], b[5], a[2] * b[8])),
        fma(a[3], b[0], fma(a[4], b[3], a[5] * b[6])),
        fma(a[3], b[1], fma(a[4], b[4], a[5] * b[7])),
        fma(a[3], b[2], fma(a[4], b[5], a[5] * b[8])),
        fma(a[6], b[0], fma(a[7], b[3], a[8] * b[6])),
        fma(a[6], b[1], fma(a[7], b[4], a[8] * b[7])),
        fma(a[6], b[2], fma(a[7], b[5], a[8] * b[8])),
    )


@inner
def rotation_matrix(sine, versine, v):
    """Return I + sine X + versine X^2 with the skew matrix X of the vector v."""
    x, y, z = v
    return (
        1.0 - versine * (y * y + z * z), versine * x * y - sine * z, versine * x * z + sine * y,
        versine * x * y + sine * z, 1.0 - versine * (x * x + z * z), versine * y * z - sine * x,
        versine * x * z - sine * y, versine * y * z + sine * x, 1.0 - versine * (x * x + y * y),
    )  # fmt: skip
