"""Closed forms: natural frequencies of uniform Euler-Bernoulli beams and bars, from their characteristic equations.

Nothing but NumPy and SciPy computes here, so that a closed form shares no error with the simulator that it checks.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from flexman_gym.common.arrays import Array


def cantilever_eigenvalues(count: int, tip_mass_ratio: float = 0.0) -> Array:
    """First lambda = omega sqrt(rho A L^4 / EI) (count,) of a cantilever; mu = tip_mass_ratio = tip mass / beam mass.

    With w a function of b x / L, b = sqrt(lambda), primes by that argument: w = w' = 0 at the base; w'' = 0 and
    w''' + mu b w = 0 at the tip. So 1 + cos b cosh b + mu b (cos b sinh b - sin b cosh b) = 0, once in each interval
    between neighbouring multiples of pi.
    """

    def characteristic(b: float) -> float:  # divided by cosh b
        return 1.0 / np.cosh(b) + np.cos(b) + tip_mass_ratio * b * (np.cos(b) * np.tanh(b) - np.sin(b))

    return _squared_roots(characteristic, np.linspace(0.0, np.pi * count, count + 1))


def hub_beam_eigenvalues(count: int, hub_inertia_ratio: float) -> Array:
    """First elastic lambda (count,) of a beam turning freely with a hub; eta = hub inertia / (rho A L^3).

    The base has w = 0 and w'' + eta b^3 w' = 0. So sin b cosh b - cos b sinh b + eta b^3 (1 + cos b cosh b) = 0, once
    between neighbouring cantilever roots, which are its limit for a heavy hub.
    """

    def characteristic(b: float) -> float:  # divided by cosh b
        clamped = 1.0 / np.cosh(b) + np.cos(b)
        return np.sin(b) - np.cos(b) * np.tanh(b) + hub_inertia_ratio * b**3 * clamped

    return _squared_roots(characteristic, np.sqrt(cantilever_eigenvalues(count + 1)))


def flexible_joint_eigenvalues(
    count: int, stiffness_ratio: float, rotor_inertia_ratio: float | None, tip_mass_ratio: float
) -> Array:
    """First elastic lambda (count,) of a beam on a torsion spring that a rotor carries, with a mass at its tip.

    kappa = stiffness_ratio = K L / EI; eta = rotor inertia / (rho A L^3), None for a clamped rotor; mu = tip mass /
    beam mass. The spring turns the base by kappa b w'; a free rotor answers it with (kappa - eta b^4) theta_m =
    kappa b w'. So w = 0 and (kappa - eta b^4) w'' + kappa eta b^3 w' = 0 at the base, b w'' = kappa w' with the rotor
    clamped; the tip is that of `cantilever_eigenvalues`.
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
    """First lambda (count,) of a stepped cantilever; lambda with L of the whole, rho A and EI of the inboard segment.

    place = length of the inboard segment / L; kappa = rigidity_ratio = EI and mu = mass_ratio = rho A of the outboard
    segment over the inboard one's. With b x / L the argument inboard, from the base, and c y / L outboard, from the
    tip, c = b (mu / kappa)^(1/4), each segment has the two solutions that its end allows. At the step w, w', EI w'' and
    EI w''' agree, y running backwards: four homogeneous equations, whose determinant vanishes.
    """
    quicker = (mass_ratio / rigidity_ratio) ** 0.25

    def solutions(x: float, end: float) -> Array:
        # (4, 2): w to w''' of cos + end cosh, divided by cosh x, and of sin - cos - end exp(-x), that is of sin + end
        # sinh less the former; of a clamped end with -1, of a free one with 1
        s, c, one, sh, fall = np.sin(x), np.cos(x), 1.0 / np.cosh(x), np.tanh(x), end * np.exp(-x)
        first = [c * one + end, -s * one + end * sh, -c * one + end, s * one + end * sh]
        return np.transpose([first, [s - c - fall, c + s + fall, c - s - fall, -c - s + fall]])

    def characteristic(b: float) -> float:
        back = np.array([1.0, -quicker, rigidity_ratio * quicker**2, -rigidity_ratio * quicker**3])
        inboard, outboard = solutions(b * place, -1.0), solutions(b * quicker * (1.0 - place), 1.0)
        return float(np.linalg.det(np.hstack([inboard, back[:, None] * outboard])))

    phase = place + quicker * (1.0 - place)  # of the waves, per b
    return _first_squared_roots(characteristic, count, np.arange(0.05, (count + 2) * np.pi, 0.01) / phase)


def bar_eigenvalues(count: int, elements: int | None = None) -> Array:
    """First omega L / c (count,) of a bar clamped at one end; c = sqrt(E / rho), in torsion sqrt(G J / rho I_p).

    Exact, (2 n - 1) pi / 2; or for equal linear elements with consistent mass: omega h / c = sqrt(6 (1 - cos a) /
    (2 + cos a)) with a = (2 n - 1) pi / (2 elements).
    """
    exact = np.pi * (np.arange(count, dtype=np.float64) + 0.5)
    if elements is None:
        return exact
    cosine = np.cos(exact / elements)
    return np.array(elements * np.sqrt(6.0 * (1.0 - cosine) / (2.0 + cosine)))


def _squared_roots(function: Callable[[float], float], ends: Array) -> Array:
    """Squares of the roots of `function`, one in every interval between neighbouring `ends`."""
    return np.square([brentq(function, a, b, xtol=1e-14, rtol=1e-14) for a, b in pairwise(ends)])


def _first_squared_roots(function: Callable[[float], float], count: int, ends: Array) -> Array:
    """Squares (count,) of the first roots of `function`, at most one between neighbouring `ends`."""
    signs = np.sign([function(end) for end in ends])
    result = [brentq(function, ends[i], ends[i + 1], xtol=1e-14) for i in np.nonzero(np.diff(signs))[0][:count]]
    return np.square(result)
