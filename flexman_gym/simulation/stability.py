"""Numerical stability: amplification factors and stability limits of integration methods.

The test problem is a free undamped vibration of angular frequency omega, integrated with steps h. The factors follow
from the coefficients of the method and depend on omega h alone.
"""

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.kernels.implicit import DIAGONAL, FROZEN_ITERATIONS, GAUSS_NODE, LOWER, RELAXATION, REMAINDER
from flexman_gym.simulation.methods import (
    Explicit,
    Implicit,
    IteratedGauss,
    LinearlyImplicit,
    Method,
)

NEGLIGIBLE_GROWTH = 1e-6  # dimensionless; growth per step still counted as stable for explicit methods


def amplification_factors(method: Method, angle: float | Array) -> NDArray[np.complex128]:
    """Return the complex factors (..., f) by which one step multiplies the components of an undamped vibration.

    Runge-Kutta and linearly implicit methods have one factor (with its conjugate), the stability function R(i omega h).
    The semi-implicit Euler method and the iterated Gauss method of two stages have two factors and the
    generalised-alpha method three, the eigenvalues of their amplification matrices.

    Args:
        method: method of fixed steps.
        angle: omega h, the phase by which the exact vibration advances in a step, rad; a number or an array (...).

    Raises:
        ValueError: for an adaptive method, which has no fixed step.
        TypeError: for a family of methods without factors here.
    """
    angle = np.asarray(angle, dtype=np.float64)
    if method.adaptive:
        raise ValueError(f"method: {method.name} chooses its steps; give a method of fixed steps")
    if not isinstance(method, Explicit | LinearlyImplicit | Implicit | IteratedGauss):
        raise TypeError(f"method: amplification_factors lacks the family {type(method).__name__} of {method.name}")
    if isinstance(method, Implicit | IteratedGauss):
        return _implicit_factors(method, angle)
    if isinstance(method, LinearlyImplicit):
        matrix = method.a + method.coupling + method.gamma * np.eye(len(method.b))
        result = np.zeros(angle.shape, dtype=np.complex128)
        for weight, parts in zip(method.tableau.weights, method.sequence, strict=True):
            result += weight * _stability(matrix, method.b, 1j * angle / parts) ** parts
        return result[..., None]
    if method.semi_implicit:
        return _eigenvalues(_matrices([[1.0 - angle**2, angle], [-angle, np.ones_like(angle)]]))
    return _stability(method.a, method.b, 1j * angle)[..., None]


def _stability(matrix: Array, b: Array, z: np.ndarray) -> np.ndarray:
    """Return R(z), the factor of a step of length 1 of a Runge-Kutta method for y' = z y."""
    size = len(b)
    stages = np.linalg.solve(np.eye(size) - z[..., None, None] * matrix, np.ones((*z.shape, size, 1)))
    return 1.0 + z * (stages[..., 0] @ b)


def _implicit_factors(method: Implicit | IteratedGauss, angle: Array) -> NDArray[np.complex128]:
    if isinstance(method, IteratedGauss) and method.stages > 1:
        return _pair_factors(method.iterations, angle)
    if isinstance(method, IteratedGauss) and method.correction:
        return _corrected_factors(method.correction, angle)
    if isinstance(method, IteratedGauss) or method.radius is None:  # one iteration is exact for a linear problem
        return ((1.0 + 0.5j * angle) / (1.0 - 0.5j * angle))[..., None]
    alpha_m, alpha_f, beta, gamma = method.coefficients[:4]
    square = angle**2
    # For q, h v and h^2 a: (1 - alpha_m) a1 + alpha_m a = -omega^2 ((1 - alpha_f) q1 + alpha_f q), Newmark's q1 and v1.
    after: list[list[Any]] = [[1.0, 0.0, -beta], [0.0, 1.0, -gamma], [(1.0 - alpha_f) * square, 0.0, 1.0 - alpha_m]]
    before: list[list[Any]] = [[1.0, 1.0, 0.5 - beta], [0.0, 1.0, 1.0 - gamma], [-alpha_f * square, 0.0, -alpha_m]]
    return _eigenvalues(np.linalg.solve(_matrices(after), _matrices(before)))


def _corrected_factors(correction: float, angle: Array) -> NDArray[np.complex128]:
    """Return the factors of the corrected midpoint rule: eigenvalues of one step for q, h v; q'' = -omega^2 q."""
    w = _corrected_acceleration(correction, angle)
    return _eigenvalues(_matrices([[1.0 + 0.5 * w, 1.0 + 0.25 * w], [w, 1.0 + 0.5 * w]]))


def _corrected_acceleration(correction: float, angle: Array) -> Array:
    """Return the acceleration (...) times h^2 of a step of the corrected midpoint rule, for q + h v / 2 = 1."""
    u = 0.25 * angle**2
    result: Array = -4.0 * u / (1.0 + u) * (1.0 + 4.0 * correction * u / (1.0 + u) ** 3)
    return result


def amplitude_range(method: IteratedGauss, angle: float) -> tuple[float, float]:
    """Return the bounds of amplitude / initial amplitude of an undamped vibration under the corrected midpoint rule.

    The amplitude is sqrt(q^2 + (v / omega)^2). A step with the matrix [[1 + w/2, 1 + w/4], [w, 1 + w/2]] for q and h v
    keeps -w q^2 + (1 + w/4) (h v)^2, an ellipse in place of the circle of equal amplitudes: the amplitude oscillates
    between the half axes of the ellipse, by at most (omega h)^2 / 12, and neither decays nor grows.

    Args:
        method: midpoint rule (one stage) with or without correction.
        angle: omega h, rad.

    Raises:
        ValueError: for two stages.
    """
    if method.stages > 1:
        raise ValueError(f"method: {method.name} has {method.stages} stages; give a midpoint rule")
    w = float(_corrected_acceleration(method.correction, np.asarray(angle, dtype=np.float64)))
    ratio = math.sqrt(-w / (1.0 + 0.25 * w)) / angle
    return min(ratio, 1.0 / ratio), max(ratio, 1.0 / ratio)


def _pair_factors(iterations: int, angle: Array) -> NDArray[np.complex128]:
    """Return the factors of the two-stage method: eigenvalues of one step for q and h v, with q'' = -omega^2 q."""
    square, ends = angle**2, []
    for q, speed in ((1.0, 0.0), (0.0, 1.0)):
        w = [-square * (q + 0.5 * speed) / (1.0 + 0.25 * square)] * 2
        v = [speed + (0.5 + side * GAUSS_NODE) * w[0] for side in (-1, 1)]
        for relaxed in (RELAXATION,) * FROZEN_ITERATIONS + (1.0,) * iterations:
            positions, speeds = q + REMAINDER * (v[0] + v[1]), speed + REMAINDER * (w[0] + w[1])
            for i in range(2):
                before = speeds + i * LOWER * w[0]
                position = positions + i * LOWER * v[0] + DIAGONAL * before
                new = -square * position / (1.0 + DIAGONAL**2 * square)
                v[i] = v[i] + relaxed * (before + DIAGONAL * new - v[i])
                w[i] = w[i] + relaxed * (new - w[i])
        ends.append((q + 0.5 * (v[0] + v[1]), speed + 0.5 * (w[0] + w[1])))
    return _eigenvalues(_matrices([list(row) for row in zip(*ends, strict=True)]))


def _matrices(rows: list[list[Any]]) -> Array:
    """Return matrices (..., f, f) from rows of numbers or arrays (...)."""
    entries = np.broadcast_arrays(*(entry for row in rows for entry in row))
    return np.stack(entries, axis=-1).reshape(*entries[0].shape, len(rows), len(rows))


def _eigenvalues(matrix: np.ndarray) -> NDArray[np.complex128]:
    return np.linalg.eigvals(matrix).astype(np.complex128)


def spectral_radii(method: Method, angles: float | Array) -> Array:
    """Return the largest magnitudes (...) of the amplification factors at omega h = `angles` (...), rad."""
    return np.abs(amplification_factors(method, angles)).max(axis=-1)


@cache
def stability_limit(method: Method, growth: float = 0.0) -> float:
    """Return the largest omega h (rad) up to which no step multiplies an undamped vibration by more than 1 + growth.

    The limit is infinite for a method that is stable at every omega h up to 1e4. A growth of 1e-12 is attributed to
    rounding.
    """
    grid = np.concatenate([np.arange(1, 10_000) * 1e-3, np.geomspace(10.0, 1e4, 300)])
    highest = 1.0 + growth + 1e-12
    unstable = spectral_radii(method, grid) > highest
    if not unstable.any():
        return math.inf
    above = int(unstable.argmax())
    low, high = (grid[above - 1] if above else 0.0), grid[above]
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if spectral_radii(method, middle) <= highest else (low, middle)
    return float(low)


def remaining_amplitude(method: Method, step: float, frequency: float, duration: float = 10.0) -> float:
    """Return final / initial amplitude of an undamped vibration integrated by a method; 1 without numerical damping.

    Args:
        method: method of fixed steps.
        step: s.
        frequency: frequency of the vibration, Hz.
        duration: s.
    """
    return float(spectral_radii(method, 2.0 * np.pi * frequency * step) ** (duration / step))
