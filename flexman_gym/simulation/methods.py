"""Methods: all integration methods, by name."""

import math
from collections.abc import Sequence

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.simulation.dormand_prince import A5, A8, B5, B8, ERROR5, ERROR8_3, ERROR8_5
from flexman_gym.simulation.families import Explicit, Implicit, LinearlyImplicit, Method, Outside, Sweeps


def generalised_alpha(radius: float) -> Implicit:
    """Builds the generalised-alpha method with a spectral radius at infinite frequency from 0 to 1.

    Raises:
        ValueError: for a radius that is not from 0 to 1.
    """
    source = "Chung and Hulbert 1993; Arnold and Bruls 2007, Multibody System Dynamics 18, 185"
    return Implicit("generalised_alpha", 2, source, radius)


def _lower(size: int, rows: Sequence[Sequence[float]]) -> Array:
    matrix = np.zeros((size, size))
    for i, row in enumerate(rows, start=1):
        matrix[i, : len(row)] = row
    return matrix


def _explicit() -> tuple[Explicit, ...]:
    euler = Explicit(
        "semi_implicit_euler", 1, "symplectic Euler: Hairer, Lubich and Wanner, Geometric Numerical "
        "Integration, I.1", np.zeros((1, 1)), np.ones(1), semi_implicit=True,
    )  # fmt: skip
    third = _lower(4, [[0.5], [0.0, 0.5], [0.0, 0.0, 1.0]])
    rk4 = Explicit("rk4", 4, "Kutta 1901", third, np.array([1, 2, 2, 1]) / 6)
    pair = "Dormand and Prince 1980; Hairer, Norsett and Wanner, Solving ODEs I, II.5"
    dopri5 = Explicit("dopri5", 5, pair, _lower(6, A5), np.array(B5), error=np.array([ERROR5]))
    source = "Dormand and Prince; Hairer, Norsett and Wanner, Solving ODEs I, II.10"
    errors = np.array([ERROR8_5, ERROR8_3])
    return euler, rk4, dopri5, Explicit("dop853", 8, source, _lower(12, A8), np.array(B8), errors, adaptive=True)


def _linearly_implicit() -> tuple[LinearlyImplicit, ...]:
    gamma = 1 - math.sqrt(0.5)  # L-stable
    ros2 = LinearlyImplicit(
        name="ros2",
        order=2,
        source="Verwer, Spee, Blom and Hundsdorfer 1999, SIAM J. Sci. Comput. 20, 1456",
        a=_lower(2, [[1.0]]),
        b=np.array([0.5, 0.5]),
        gamma=gamma,
        coupling=_lower(2, [[-2 * gamma]]),
        error=np.array([[-0.5, 0.5]]),  # difference from the first stage alone
    )
    source = "Deuflhard 1985, SIAM Review 27, 505; Hairer and Wanner, Solving ODEs II, IV.9"
    one, zero = np.ones(1), np.zeros((1, 1))
    return ros2, *(
        LinearlyImplicit(f"extrapolated_euler_{n}", n, source, zero, one, 1.0, zero,
                         sequence=tuple(range(1, n + 1))) for n in range(3, 9)
    )  # fmt: skip


def _implicit() -> tuple[Method, ...]:
    source = "Hairer, Lubich and Wanner, Geometric Numerical Integration, II.1"
    midpoint = Implicit("implicit_midpoint", 2, source)
    sweeps = [Sweeps(f"midpoint_{n}_sweeps", 2, f"{source}; Newton's iterations: VIII.6", n) for n in (2, 3)]
    pairs = f"{source}; van der Houwen and Swart 1997, SIAM J. Sci. Comput. 18, 41"
    sweeps += [Sweeps(f"gauss_{n}_sweeps", n + 1, pairs, n, 2) for n in (2, 3)]
    radau = Outside("radau", 5, "Hairer and Wanner, Solving ODEs II, IV.8; the integrator of SciPy")
    return midpoint, *sweeps, generalised_alpha(0.9), radau


DEFAULT = "midpoint_3_sweeps"  # wherever steps are fixed and no method is named


class Methods(dict[str, Method]):
    """Methods of integration: name -> Method, for `fm.simulate(scene, method=name, step=...)`.

    A Method has `order` (1; the error of a time falls with the step to that power), `kind` ("explicit", "linearly
    implicit", "implicit" or "reference") and `source`. With a fixed `step` (s) any of them runs; those of kind
    "reference", and those that estimate their error, choose steps by `rtol` (1) and `atol` (rad, m, and their rates).
    `flexman list methods` prints them.
    """


METHODS = Methods({method.name: method for method in (*_explicit(), *_linearly_implicit(), *_implicit())})
"""Methods that have a name: name -> Method, with its order, family and source."""
