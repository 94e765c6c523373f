"""Amplification: the factors by which one step of a method multiplies a free undamped vibration.

They follow from the coefficients of the method.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Array
from flexman_gym.simulation.families import (
    EXPLICIT,
    Explicit,
    Implicit,
    LinearlyImplicit,
    Method,
    Midpoint,
    extrapolation_weights,
)


def amplification_factors(method: Method, angle: float) -> NDArray[np.complex128]:
    """Gives the complex factors by which a step of a method multiplies the parts of an undamped vibration.

    Runge-Kutta and linearly implicit methods have one factor (with its conjugate), the stability function R(i omega h).
    The semi-implicit Euler method has two and the generalised-alpha method three, the eigenvalues of their
    amplification matrix.

    Args:
        method: the method.
        angle: omega h, the angle by which the exact vibration turns in a step, rad.

    Raises:
        ValueError: for a reference method, which has no fixed step.
    """
    if method.adaptive or not isinstance(method, Explicit | LinearlyImplicit | Implicit | Midpoint):
        raise ValueError(f"method: {method.name} chooses its steps; give one of fixed steps")
    if isinstance(method, Implicit | Midpoint):
        return _implicit_factors(method, angle)
    if isinstance(method, LinearlyImplicit):
        weights, matrix = extrapolation_weights(method.sequence), method.a + method.coupling
        matrix = matrix + method.gamma * np.eye(len(method.b))
        factors = (_stability(matrix, method.b, 1j * angle / parts) ** parts for parts in method.sequence)
        return np.array([sum(weight * factor for weight, factor in zip(weights, factors, strict=True))])
    if method.semi_implicit:
        return _eigenvalues(np.array([[1.0 - angle**2, angle], [-angle, 1.0]]))
    return np.array([_stability(method.a, method.b, 1j * angle)])


def _stability(matrix: Array, b: Array, z: complex) -> complex:
    """Gives R(z), the factor of a step of length 1 of a Runge-Kutta method for y' = z y."""
    ones = np.ones(len(b))
    return complex(1.0 + z * b @ np.linalg.solve(np.eye(len(b)) - z * matrix, ones))


def _implicit_factors(method: Implicit | Midpoint, angle: float) -> NDArray[np.complex128]:
    if isinstance(method, Midpoint) or method.radius is None:  # one sweep is exact where all is linear
        return np.array([(1.0 + 0.5j * angle) / (1.0 - 0.5j * angle)])
    mass, force, beta, gamma = method.averages[:4]
    square = angle**2
    # For q, h v and h^2 a: (1 - mass) a1 + mass a = -omega^2 ((1 - force) q1 + force q), with Newmark's q1 and v1.
    after = [[1.0, 0.0, -beta], [0.0, 1.0, -gamma], [(1.0 - force) * square, 0.0, 1.0 - mass]]
    before = [[1.0, 1.0, 0.5 - beta], [0.0, 1.0, 1.0 - gamma], [-force * square, 0.0, -mass]]
    return _eigenvalues(np.linalg.solve(np.array(after), np.array(before)))


def _eigenvalues(matrix: Array) -> NDArray[np.complex128]:
    return np.linalg.eigvals(matrix).astype(np.complex128)


def spectral_radius(method: Method, angle: float) -> float:
    """Gives the largest magnitude of the factors of a step in which the vibration turns by an angle (rad)."""
    return float(np.abs(amplification_factors(method, angle)).max())


def vibration_factor(method: Method, angle: float) -> complex:
    """Gives the factor of the vibration itself, the one next to the exact factor exp(i omega h)."""
    factors = amplification_factors(method, angle)
    factors = np.concatenate([factors, factors.conj()])
    return complex(factors[np.abs(factors - np.exp(1j * angle)).argmin()])


@cache
def stability_limit(method: Method, growth: float = 0.0) -> float:
    """Gives the largest omega h (rad) up to which no step multiplies an undamped vibration by more than 1 + growth.

    It is infinite for a method that passes at every omega h up to 1e4. Rounding of 1e-12 counts as no growth.
    """
    grid = np.concatenate([np.arange(1, 10_000) * 1e-3, np.geomspace(10.0, 1e4, 300)])
    most = 1.0 + growth + 1e-12
    above = next((i for i, angle in enumerate(grid) if spectral_radius(method, angle) > most), None)
    if above is None:
        return math.inf
    low, high = (grid[above - 1] if above else 0.0), grid[above]
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if spectral_radius(method, middle) <= most else (low, middle)
    return float(low)


def explicit_limit(method: Method) -> float:
    """Gives the stability limit (rad) of an explicit method for a growth of 1e-6 a step, infinity for others."""
    return stability_limit(method, 1e-6) if method.kind == EXPLICIT else math.inf


def largest_growth(method: Method) -> tuple[float, float]:
    """Gives the largest factor by which a step multiplies an undamped vibration, and its omega h (rad)."""
    angles = np.geomspace(1e-3, 1e3, 1501)
    factors = [spectral_radius(method, angle) for angle in angles]
    return max(factors), float(angles[np.argmax(factors)])


def amplitude_kept(method: Method, step: float, frequency: float, duration: float = 10.0) -> float:
    """Gives the part of the amplitude of an undamped vibration that a method leaves.

    Args:
        method: the method.
        step: s.
        frequency: of the vibration, Hz.
        duration: s.
    """
    return float(spectral_radius(method, 2.0 * np.pi * frequency * step) ** (duration / step))
