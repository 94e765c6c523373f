"""Natural frequencies of beams and bars by the Rayleigh-Ritz method with polynomials of high degree.

The module shares nothing with the library: neither its finite elements nor the characteristic equations of its
verification. Frequencies converge exponentially with the degree; those below are accurate to a relative error of 1e-9
(see `test_ritz`).
"""

import numpy as np
from numpy.polynomial import Legendre, Polynomial
from scipy.linalg import eigh

DEGREE = 12  # bubbles of a segment
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(DEGREE + 8)
PLACES, SHARES = (1.0 + POINTS) / 2.0, WEIGHTS / 2.0
X = Polynomial([0.0, 1.0])


def shapes(length):
    """Return polynomials of xi in [0, 1]: deflection and slope at both ends of a segment, then bubble functions."""
    ends = [1 - 3 * X**2 + 2 * X**3, length * X * (1 - X) ** 2, 3 * X**2 - 2 * X**3, length * X**2 * (X - 1)]
    bubbles = [(X * (1 - X)) ** 2 * Legendre.basis(k).convert(kind=Polynomial)(2 * X - 1) for k in range(DEGREE)]
    return ends + bubbles


def products(functions, derivative, scale):
    """Return the integrals over a segment of the products of derivatives of an order."""
    values = np.array([function.deriv(derivative)(PLACES) for function in functions])
    return scale * (values * SHARES) @ values.T


def beam_eigenvalues(
    count, tip_mass_ratio=0.0, segments=((1.0, 1.0, 1.0),), gyration_ratio=0.0, hub_inertia_ratio=None, spring=None
):
    """Return the first omega (count,) of a beam of segments (length, EI, rho A) with a mass at its free end.

    The base is clamped, turns with a hub inertia, or is connected by a spring (stiffness, rotor inertia, or None for a
    clamped rotor). The frequency 0 of a freely turning beam is omitted.
    """
    size = 2 * (len(segments) + 1) + DEGREE * len(segments) + 1  # nodes, bubbles, rotor
    stiffness, mass = np.zeros((size, size)), np.zeros((size, size))
    for i, (length, rigidity, density) in enumerate(segments):
        first = 2 * (len(segments) + 1) + DEGREE * i
        places = np.ix_(*[[*range(2 * i, 2 * i + 4), *range(first, first + DEGREE)]] * 2)
        functions = shapes(length)
        stiffness[places] += products(functions, 2, rigidity / length**3)
        mass[places] += products(functions, 0, density * length)
        mass[places] += products(functions, 1, gyration_ratio * density / length)
    tip = 2 * len(segments)
    mass[tip, tip] += tip_mass_ratio
    kept, turning = [1, *range(2, size - 1)], 1  # the base does not move sideways, and may turn freely
    if hub_inertia_ratio is not None:
        mass[1, 1] += hub_inertia_ratio
    elif spring is not None:
        stiffness[np.ix_([1, size - 1], [1, size - 1])] += spring[0] * np.array([[1.0, -1.0], [-1.0, 1.0]])
        if spring[1] is not None:
            kept, mass[-1, -1] = [*kept, size - 1], spring[1]
        else:
            turning = 0
    else:
        kept, turning = kept[1:], 0
    stiffness, mass = stiffness[np.ix_(kept, kept)], mass[np.ix_(kept, kept)]
    # 1 / (1 + omega^2), as rounding spares the largest eigenvalues
    result = eigh(mass, stiffness + mass, eigvals_only=True)[::-1]
    return np.sqrt(1.0 / result[turning : turning + count] - 1.0)


def bar_eigenvalues(count):
    """Return the first omega (count,) of a bar clamped at one end, with c / L = 1."""
    functions = [X * Legendre.basis(k).convert(kind=Polynomial)(2 * X - 1) for k in range(DEGREE + 4)]
    return np.sqrt(eigh(products(functions, 1, 1.0), products(functions, 0, 1.0), eigvals_only=True)[:count])
