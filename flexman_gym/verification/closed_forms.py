"""Natural frequencies of uniform Euler-Bernoulli beams and bars in closed form, from their characteristic equations.

The module uses only NumPy and SciPy, so that the closed forms share no error with the simulator that they verify.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from flexman_gym.common.arrays import Array


def cantilever_eigenvalues(count: int, tip_mass_ratio: float = 0.0) -> Array:
    """Return the first eigenvalues lambda = omega sqrt(rho A L^4 / EI) (count,) of a cantilever with a tip mass.

    With b = sqrt(lambda) and w a function of b x / L, primes denote derivatives by this argument. The boundary
    conditions are w = w' = 0 at the base, and w'' = 0 and w''' + mu b w = 0 at the tip. They give the characteristic
    equation 1 + cos b cosh b + mu b (cos b sinh b - sin b cosh b) = 0, with one root between successive multiples of
    pi.

    Args:
        count: number of eigenvalues.
        tip_mass_ratio: mu = tip mass / beam mass.
    """

    def characteristic(b: float) -> float:  # divided by cosh b
        return 1.0 / np.cosh(b) + np.cos(b) + tip_mass_ratio * b * (np.cos(b) * np.tanh(b) - np.sin(b))

    return _squared_roots(characteristic, np.linspace(0.0, np.pi * count, count + 1))


def hub_beam_eigenvalues(count: int, hub_inertia_ratio: float) -> Array:
    """Return the first elastic eigenvalues lambda (count,) of a beam that turns freely with a hub.

    The boundary conditions at the base are w = 0 and w'' + eta b^3 w' = 0, with the notation of
    `cantilever_eigenvalues`. They give sin b cosh b - cos b sinh b + eta b^3 (1 + cos b cosh b) = 0, with one root
    between successive roots of the cantilever, which is the limit for a heavy hub.

    Args:
        count: number of eigenvalues.
        hub_inertia_ratio: eta = hub inertia / (rho A L^3).
    """

    def characteristic(b: float) -> float:  # divided by cosh b
        clamped = 1.0 / np.cosh(b) + np.cos(b)
        return np.sin(b) - np.cos(b) * np.tanh(b) + hub_inertia_ratio * b**3 * clamped

    return _squared_roots(characteristic, np.sqrt(cantilever_eigenvalues(count + 1)))


def flexible_joint_eigenvalues(
    count: int, stiffness_ratio: float, rotor_inertia_ratio: float | None, tip_mass_ratio: float
) -> Array:
    """Return the first elastic eigenvalues lambda (count,) of a beam with a tip mass on a flexible joint.

    The torsion spring of the joint is carried by a rotor and turns the base by kappa b w'. A free rotor turns by
    theta_m with (kappa - eta b^4) theta_m = kappa b w'. The conditions at the base are w = 0 and (kappa - eta b^4) w''
    + kappa eta b^3 w' = 0, or b w'' = kappa w' with the rotor clamped; those at the tip are the same as in
    `cantilever_eigenvalues`.

    Args:
        count: number of eigenvalues.
        stiffness_ratio: kappa = K L / EI of the joint spring K.
        rotor_inertia_ratio: eta = rotor inertia / (rho A L^3); None for a clamped rotor.
        tip_mass_ratio: mu = tip mass / beam mass.
    """

    def characteristic(b: float) -> float:  # columns: w = sin, and cos - cosh and sinh divided by cosh b
        s, c, one, sh, mu = np.sin(b), np.cos(b), 1.0 / np.cosh(b), np.tanh(b), tip_mass_ratio * b
        bend, slope = b, -stiffness_ratio
        if rotor_inertia_ratio is not None:
            bend = stiffness_ratio - rotor_inertia_ratio * b**4
            slope = stiffness_ratio * rotor_inertia_ratio * b**3
        base = [slope, -2.0 * bend * one, slope * one]
        moment = [-s, -(c * one + 1.0), sh]
        force = [-c + mu * s, s * one - sh + mu * (c * one - 1.0), 1.0 + mu * sh]
        return float(np.linalg.det([base, moment, force]))

    return _first_squared_roots(characteristic, count, np.arange(0.05, (count + 2) * np.pi, 0.01))


def stepped_cantilever_eigenvalues(count: int, place: float, rigidity_ratio: float, mass_ratio: float) -> Array:
    """Return the first eigenvalues lambda (count,) of a cantilever with one step in its cross-section.

    lambda refers to the total length L and to rho A and EI of the inboard segment. The argument of w is b x / L from
    the base in the inboard segment, and c y / L from the tip in the outboard segment, with c = b (mu / kappa)^(1/4).
    Each segment has the two solutions that its end condition admits. Continuity of w, w', EI w'' and EI w''' at the
    step, with y in the opposite direction, gives four homogeneous equations, whose determinant vanishes.

    Args:
        count: number of eigenvalues.
        place: length of the inboard segment / L.
        rigidity_ratio: kappa = EI of the outboard segment / EI of the inboard segment.
        mass_ratio: mu = rho A of the outboard segment / rho A of the inboard segment.
    """
    scale = (mass_ratio / rigidity_ratio) ** 0.25  # c / b

    def solutions(x: float, end: float) -> Array:
        # (4, 2): w to w''' of (cos + end cosh) / cosh x, and of sin - cos - end exp(-x), which is sin + end sinh minus
        # the first solution; end is -1 for a clamped and 1 for a free end
        s, c, one, sh, decay = np.sin(x), np.cos(x), 1.0 / np.cosh(x), np.tanh(x), end * np.exp(-x)
        first = [c * one + end, -s * one + end * sh, -c * one + end, s * one + end * sh]
        return np.transpose([first, [s - c - decay, c + s + decay, c - s - decay, -c - s + decay]])

    def characteristic(b: float) -> float:
        signs = np.array([1.0, -scale, rigidity_ratio * scale**2, -rigidity_ratio * scale**3])
        inboard, outboard = solutions(b * place, -1.0), solutions(b * scale * (1.0 - place), 1.0)
        return float(np.linalg.det(np.hstack([inboard, signs[:, None] * outboard])))

    phase = place + scale * (1.0 - place)  # of the waves per unit b
    return _first_squared_roots(characteristic, count, np.arange(0.05, (count + 2) * np.pi, 0.01) / phase)


def bar_eigenvalues(count: int, elements: int | None = None) -> Array:
    """Return the first omega L / c (count,) of a bar clamped at one end, in axial vibration or torsion.

    The wave speed c is sqrt(E / rho), or sqrt(G J / rho I_p) in torsion. The exact values are (2 n - 1) pi / 2. Equal
    linear elements with consistent mass have omega h / c = sqrt(6 (1 - cos a) / (2 + cos a)) with a = (2 n - 1) pi / (2
    elements).

    Args:
        count: number of eigenvalues.
        elements: number of finite elements; None for the exact values.
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
