"""Dimensionless natural frequencies of Euler-Bernoulli beams and bars in closed form, from characteristic equations.

For a beam of length L, bending stiffness EI and mass per length rho A the dimensionless natural frequency is lambda =
omega L^2 sqrt(rho A / EI) = b^2 with the frequency parameter b = beta L, where d^4 w / dx^4 = beta^4 w (Blevins,
Formulas for Natural Frequency and Mode Shape, tabulates b). Below, the deflection w is a function of b x / L, and w' is
its derivative by this argument: dw/dx = (b / L) w'. The module uses only NumPy and SciPy, so that it shares no error
with the simulator that it verifies.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from flexman_gym.common.arrays import Array


def cantilever_frequencies(count: int, tip_mass_ratio: float = 0.0) -> Array:
    """Return the first dimensionless natural frequencies lambda (count,) of a cantilever with a tip mass.

    The boundary conditions are w = w' = 0 at the base, and w'' = 0 and w''' + mu b w = 0 at the tip. They give the
    characteristic equation 1 + cos b cosh b + mu b (cos b sinh b - sin b cosh b) = 0, with one root between successive
    multiples of pi.

    Args:
        count: number of frequencies.
        tip_mass_ratio: mu = tip mass / beam mass, 1.
    """

    def characteristic(b: float) -> float:  # divided by cosh b
        return 1.0 / np.cosh(b) + np.cos(b) + tip_mass_ratio * b * (np.cos(b) * np.tanh(b) - np.sin(b))

    return _squared_roots(characteristic, np.linspace(0.0, np.pi * count, count + 1))


def hub_beam_frequencies(count: int, hub_inertia_ratio: float) -> Array:
    """Return the first dimensionless natural frequencies lambda > 0 (count,) of a beam with a freely rotating hub.

    The boundary conditions at the base are w = 0 and w'' + eta b^3 w' = 0. They give the characteristic equation sin b
    cosh b - cos b sinh b + eta b^3 (1 + cos b cosh b) = 0, with one root between successive roots of the cantilever,
    which is the limit for eta to infinity.

    Args:
        count: number of frequencies, without the zero frequency of the rigid rotation.
        hub_inertia_ratio: eta = hub inertia / (rho A L^3), 1.
    """

    def characteristic(b: float) -> float:  # divided by cosh b
        clamped = 1.0 / np.cosh(b) + np.cos(b)
        return np.sin(b) - np.cos(b) * np.tanh(b) + hub_inertia_ratio * b**3 * clamped

    return _squared_roots(characteristic, np.sqrt(cantilever_frequencies(count + 1)))


def flexible_joint_frequencies(
    count: int, stiffness_ratio: float, rotor_inertia_ratio: float | None, tip_mass_ratio: float
) -> Array:
    """Return the first dimensionless natural frequencies lambda > 0 (count,) of a beam on a flexible joint.

    The torsion spring of the joint connects the base of the beam, at the angle b w' / L, to a rotor at the angle
    theta_m, with (kappa - eta b^4) theta_m = kappa b w' / L for a free rotor. The boundary conditions at the base are w
    = 0 and (kappa - eta b^4) w'' + kappa eta b^3 w' = 0, or b w'' = kappa w' with a clamped rotor; at the tip they are
    the conditions in `cantilever_frequencies`.

    Args:
        count: number of frequencies, without the zero frequency of the rigid rotation.
        stiffness_ratio: kappa = K L / EI, 1, with the joint stiffness K.
        rotor_inertia_ratio: eta = rotor inertia / (rho A L^3), 1; None for a clamped rotor.
        tip_mass_ratio: mu = tip mass / beam mass, 1.
    """

    def characteristic(b: float) -> float:  # columns: w = sin, and cos - cosh and sinh divided by cosh b
        s, c, sech, sh, mu = np.sin(b), np.cos(b), 1.0 / np.cosh(b), np.tanh(b), tip_mass_ratio * b
        curvature, slope = b, -stiffness_ratio  # coefficients of w'' and w' in the condition at the base
        if rotor_inertia_ratio is not None:
            curvature = stiffness_ratio - rotor_inertia_ratio * b**4
            slope = stiffness_ratio * rotor_inertia_ratio * b**3
        base = [slope, -2.0 * curvature * sech, slope * sech]
        moment = [-s, -(c * sech + 1.0), sh]
        force = [-c + mu * s, s * sech - sh + mu * (c * sech - 1.0), 1.0 + mu * sh]
        return float(np.linalg.det([base, moment, force]))

    return _first_squared_roots(characteristic, count, np.arange(0.05, (count + 2) * np.pi, 0.01))


def stepped_cantilever_frequencies(count: int, step_position: float, rigidity_ratio: float, mass_ratio: float) -> Array:
    """Return the first dimensionless natural frequencies lambda (count,) of a cantilever with a stepped cross-section.

    lambda refers to the total length L and to rho A and EI of the inboard segment. The argument of w is b x / L from
    the base in the inboard segment, and c y / L from the tip in the outboard segment, with c = b (mu / kappa)^(1/4). In
    each segment two solutions meet the boundary conditions at its end. Continuity of w, w', EI w'' and EI w''' at the
    step, with y in the opposite direction, gives four homogeneous equations, whose determinant vanishes.

    Args:
        count: number of frequencies.
        step_position: length of the inboard segment / L, 1.
        rigidity_ratio: kappa = EI of the outboard segment / EI of the inboard segment, 1.
        mass_ratio: mu = rho A of the outboard segment / rho A of the inboard segment, 1.
    """
    scale = (mass_ratio / rigidity_ratio) ** 0.25  # c / b

    def solutions(x: float, end: float) -> Array:
        # (4, 2): w to w''' of (cos + end cosh) / cosh x, and of sin - cos - end exp(-x), which is sin + end sinh minus
        # the first solution; end is -1 for a clamped and 1 for a free end
        s, c, sech, sh, decay = np.sin(x), np.cos(x), 1.0 / np.cosh(x), np.tanh(x), end * np.exp(-x)
        first = [c * sech + end, -s * sech + end * sh, -c * sech + end, s * sech + end * sh]
        return np.transpose([first, [s - c - decay, c + s + decay, c - s - decay, -c - s + decay]])

    def characteristic(b: float) -> float:
        signs = np.array([1.0, -scale, rigidity_ratio * scale**2, -rigidity_ratio * scale**3])
        inboard, outboard = solutions(b * step_position, -1.0), solutions(b * scale * (1.0 - step_position), 1.0)
        return float(np.linalg.det(np.hstack([inboard, signs[:, None] * outboard])))

    phase = step_position + scale * (1.0 - step_position)  # rad; phase of the waves along the beam per unit of b
    return _first_squared_roots(characteristic, count, np.arange(0.05, (count + 2) * np.pi, 0.01) / phase)


def bar_frequencies(count: int, elements: int | None = None) -> Array:
    """Return the first dimensionless natural frequencies omega L / c (count,) of a bar clamped at one end.

    The wave speed c is sqrt(E / rho) in axial vibration and sqrt(G J / (rho I_p)) in torsion. The exact values are (2 n
    - 1) pi / 2. N equal linear elements of length h with consistent mass have omega h / c = sqrt(6 (1 - cos a) / (2 +
    cos a)) with a = (2 n - 1) pi / (2 N).

    Args:
        count: number of frequencies.
        elements: number N of finite elements; None for the exact values.
    """
    exact = np.pi * (np.arange(count, dtype=np.float64) + 0.5)
    if elements is None:
        return exact
    cosine = np.cos(exact / elements)
    return np.array(elements * np.sqrt(6.0 * (1.0 - cosine) / (2.0 + cosine)))


def _squared_roots(function: Callable[[float], float], ends: Array) -> Array:
    """Return the squares of the roots of a function with one root in each interval between successive ends."""
    return np.square([brentq(function, a, b, xtol=1e-14, rtol=1e-14) for a, b in pairwise(ends)])


def _first_squared_roots(function: Callable[[float], float], count: int, ends: Array) -> Array:
    """Return the squares (count,) of the first roots of a function with at most one root between successive ends."""
    signs = np.sign([function(end) for end in ends])
    result = [brentq(function, ends[i], ends[i + 1], xtol=1e-14) for i in np.nonzero(np.diff(signs))[0][:count]]
    return np.square(result)
