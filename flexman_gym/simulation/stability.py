"""Numerical stability: amplification factors and stability limits of integration methods.

The test problem is a free undamped vibration of angular frequency omega, integrated with steps h. The factors follow
from the coefficients of the method and depend on omega h alone.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.simulation.methods import IteratedGauss, Method, ScipyMethod
from flexman_gym.simulation.methods.gauss import corrected_acceleration

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
    """
    angle = np.asarray(angle, dtype=np.float64)
    if method.adaptive or isinstance(method, ScipyMethod):
        raise ValueError(f"method: {method.name} chooses its steps; give a method of fixed steps")
    return method.amplification(angle)


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
    w = float(corrected_acceleration(method.correction, np.asarray(angle, dtype=np.float64)))
    ratio = math.sqrt(-w / (1.0 + 0.25 * w)) / angle
    return min(ratio, 1.0 / ratio), max(ratio, 1.0 / ratio)


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
