"""Amplification: what one step of a method makes of a free undamped vibration, from its coefficients."""

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
    extrapolation_weights,
)


def amplification_factors(method: Method, angle: float) -> NDArray[np.complex128]:
    """Complex factors by which a step of a method multiplies the parts of an undamped vibration.

    angle  omega h, the angle (rad) by which the exact vibration turns in a step

    Runge-Kutta and linearly implicit methods have one (with its conjugate), the stability function R(i omega h); the
    semi-implicit Euler method two and the generalised-alpha method three, eigenvalues of their amplification matrix.

    Raises ValueError for a reference method, which has no fixed step.
    """
    if method.adaptive or not isinstance(method, Explicit | LinearlyImplicit | Implicit):
        raise ValueError(f"method: {method.name} chooses its steps; give one of fixed steps")
    if isinstance(method, Implicit):
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
    """R(z): what a step of length 1 of a Runge-Kutta method makes of y' = z y."""
    ones = np.ones(len(b))
    return complex(1.0 + z * b @ np.linalg.solve(np.eye(len(b)) - z * matrix, ones))


def _implicit_factors(method: Implicit, angle: float) -> NDArray[np.complex128]:
    if method.radius is None:
        return np.array([(1.0 + 0.5j * angle) / (1.0 - 0.5j * angle)])
    mass, force, beta, gamma = method.averages[:4]
    square = angle**2
    # of q, h v and h^2 a: (1 - mass) a1 + mass a = -omega^2 ((1 - force) q1 + force q), with Newmark's q1 and v1
    after = [[1.0, 0.0, -beta], [0.0, 1.0, -gamma], [(1.0 - force) * square, 0.0, 1.0 - mass]]
    before = [[1.0, 1.0, 0.5 - beta], [0.0, 1.0, 1.0 - gamma], [-force * square, 0.0, -mass]]
    return _eigenvalues(np.linalg.solve(np.array(after), np.array(before)))


def _eigenvalues(matrix: Array) -> NDArray[np.complex128]:
    return np.linalg.eigvals(matrix).astype(np.complex128)


def spectral_radius(method: Method, angle: float) -> float:
    """The largest factor by which a step multiplies an undamped vibration that turns by an angle (rad) in it."""
    return float(np.abs(amplification_factors(method, angle)).max())


def vibration_factor(method: Method, angle: float) -> complex:
    """The factor that stands for the vibration itself: the one next to the exact factor exp(i omega h)."""
    factors = amplification_factors(method, angle)
    factors = np.concatenate([factors, factors.conj()])
    return complex(factors[np.abs(factors - np.exp(1j * angle)).argmin()])


@cache
def stability_limit(method: Method, growth: float = 0.0) -> float:
    """The largest omega h (rad) up to which no step multiplies an undamped vibration by more than 1 + growth.

    Infinite for a method that passes at every omega h up to 1e4. Rounding of 1e-12 counts as no growth.
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
    """The same for an explicit method, with a growth of 1e-6 a step allowed; infinite for every other one."""
    return stability_limit(method, 1e-6) if method.kind == EXPLICIT else math.inf


def largest_growth(method: Method) -> tuple[float, float]:
    """The largest factor by which a step multiplies an undamped vibration, and the omega h (rad) where it does."""
    angles = np.geomspace(1e-3, 1e3, 1501)
    factors = [spectral_radius(method, angle) for angle in angles]
    return max(factors), float(angles[np.argmax(factors)])


def amplitude_kept(method: Method, step: float, frequency: float, duration: float = 10.0) -> float:
    """Part of the amplitude of an undamped vibration (Hz) that a method with a step (s) leaves after a duration (s)."""
    return float(spectral_radius(method, 2.0 * np.pi * frequency * step) ** (duration / step))
