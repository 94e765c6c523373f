"""Explicit Runge-Kutta methods.

Order conditions: Hairer, Norsett and Wanner, Solving ODEs I, II.1. Pairs of Dormand and Prince of order 5 (1980) and
order 8 (DOP853): II.5 and II.10, with the appendix. SciPy has the same coefficients, but its import is slow. Rows of A5
and A8 omit trailing zeros.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.kernels.layout import Tableau, step_method
from flexman_gym.simulation.methods.coefficients import (
    EXPLICIT,
    REFERENCE,
    check_order,
    check_stages,
    eigenvalues,
    lower_triangular,
    matrices,
    no_error_weights,
    stability_function,
)

A5 = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
)
B5 = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)
ERROR5 = (-71 / 57600, 0.0, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40)

A8 = (
    (0.05260015195876773,),
    (0.0197250569845379, 0.0591751709536137),
    (0.02958758547680685, 0.0, 0.08876275643042054),
    (0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792),
    (0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242),
    (0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125),
    (0.03709200011850479, 0.0, 0.0, 0.17038392571223998, 0.10726203044637328, -0.015319437748624402,
     0.008273789163814023),
    (0.6241109587160757, 0.0, 0.0, -3.3608926294469414, -0.868219346841726, 27.59209969944671, 20.154067550477894,
     -43.48988418106996),
    (0.47766253643826434, 0.0, 0.0, -2.4881146199716677, -0.590290826836843, 21.230051448181193, 15.279233632882423,
     -33.28821096898486, -0.020331201708508627),
    (-0.9371424300859873, 0.0, 0.0, 5.186372428844064, 1.0914373489967295, -8.149787010746927, -18.52006565999696,
     22.739487099350505, 2.4936055526796523, -3.0467644718982196),
    (2.273310147516538, 0.0, 0.0, -10.53449546673725, -2.0008720582248625, -17.9589318631188, 27.94888452941996,
     -2.8589982771350235, -8.87285693353063, 12.360567175794303, 0.6433927460157636),
)  # fmt: skip
B8 = (0.054293734116568765, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003, -5.801203960010585,
      0.3111643669578199, -0.1521609496625161, 0.20136540080403034, 0.04471061572777259)  # fmt: skip
# Differences from solutions of order 5 and 3; the solution of order 3 has non-zero weights at three stages only.
ERROR8_5 = (0.01312004499419488, 0.0, 0.0, 0.0, 0.0, -1.2251564463762044, -0.4957589496572502, 1.6643771824549864,
            -0.35032884874997366, 0.3341791187130175, 0.08192320648511571, -0.022355307863886294, 0.0)  # fmt: skip
ERROR8_3 = (-0.18980075407240762, *B8[1:8], -0.4226823213237919, *B8[9:11], 0.02265179219836082, 0.0)


@dataclass(frozen=True, eq=False)
class Explicit:
    """Explicit Runge-Kutta method with s stages: k_i = f(y + h sum_j a_ij k_j); a step adds h sum b_i k_i.

    Attributes:
        name, order, source: see the module.
        a: (s, s) strictly lower triangular.
        b: (s,) weights.
        error: (e, s + 1) weights of e = 0, 1 or 2 error estimates; the last column weighs the derivative after the
            step.
        semi_implicit: positions advance with the speeds after the step instead of the speeds before it.
        adaptive: reference method, whose steps always follow from rtol and atol.

    Raises:
        ValueError: for inconsistent coefficients or an order they do not have (checked up to order 4).
    """

    name: str
    order: int
    source: str
    a: Array
    b: Array
    error: Array = field(default_factory=no_error_weights)
    semi_implicit: bool = False
    adaptive: bool = False
    first_step = 0

    def __post_init__(self) -> None:
        check_stages(self.name, self.a, self.b, self.error)
        check_order(self.name, self.order, self.conditions)

    @property
    def kind(self) -> str:
        """Family of the method: "explicit", or "reference" for an adaptive one."""
        return REFERENCE if self.adaptive else EXPLICIT

    @property
    def in_lanes(self) -> bool:
        """True if several arms share the vector registers of a step."""
        return not self.adaptive

    @property
    def estimates(self) -> bool:
        """Availability of an error estimate."""
        return bool(self.error.size)

    @property
    def evaluations(self) -> int:
        """Evaluations of the accelerations in a step of fixed length."""
        return len(self.b)

    @property
    def conditions(self) -> list[tuple[int, str, float]]:
        """Order conditions of order 1 to 4: (order, name, residual)."""
        a, b, ones = self.a, self.b, np.ones(len(self.b))
        c = a @ ones
        residuals = {
            (1, "sum b - 1"): b @ ones - 1,
            (2, "b c - 1/2"): b @ c - 1 / 2,
            (3, "b c^2 - 1/3"): b @ c**2 - 1 / 3,
            (3, "b a c - 1/6"): b @ a @ c - 1 / 6,
            (4, "b c^3 - 1/4"): b @ c**3 - 1 / 4,
            (4, "b c a c - 1/8"): (b * c) @ a @ c - 1 / 8,
            (4, "b a c^2 - 1/12"): b @ a @ c**2 - 1 / 12,
            (4, "b a a c - 1/24"): b @ a @ a @ c - 1 / 24,
        }
        return [(order, name, float(residual)) for (order, name), residual in residuals.items()]

    @property
    def tableau(self) -> Tableau:
        """Coefficients in the form of the kernels."""
        s = len(self.b)
        error = self.error if self.error.size else np.zeros((0, s + 1))
        exponent = 8 if len(error) == 2 else self.order
        once, one = np.ones(1, dtype=np.int64), np.ones(1)
        abscissae = np.append(self.a.sum(axis=1), 1.0)
        rest = (self.semi_implicit, once, one, one - one)
        return Tableau(self.a, self.b, np.zeros((s, s)), abscissae, error, 0.0, exponent, *rest)

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """Argument `method` of the kernels."""
        return step_method(explicit=self.tableau)

    @property
    def step_cost(self) -> float:
        """Processor time of a step, without a matrix factorisation, / that of an evaluation with one."""
        return 0.3 * len(self.b)

    def amplification(self, angle: Array) -> NDArray[np.complex128]:
        """Return the factors (..., f) of a step of an undamped vibration, for its phase (...), rad, in a step."""
        if self.semi_implicit:
            return eigenvalues(matrices([[1.0 - angle**2, angle], [-angle, np.ones_like(angle)]]))
        return stability_function(self.a, self.b, 1j * angle)[..., None]


def explicit_methods() -> tuple[Explicit, ...]:
    """Return the methods of this family."""
    euler = Explicit(
        "semi_implicit_euler", 1, "symplectic Euler: Hairer, Lubich and Wanner, Geometric Numerical "
        "Integration, I.1", np.zeros((1, 1)), np.ones(1), semi_implicit=True,
    )  # fmt: skip
    third = lower_triangular(4, [[0.5], [0.0, 0.5], [0.0, 0.0, 1.0]])
    rk4 = Explicit("rk4", 4, "Kutta 1901", third, np.array([1, 2, 2, 1]) / 6)
    pair = "Dormand and Prince 1980; Hairer, Norsett and Wanner, Solving ODEs I, II.5"
    dopri5 = Explicit("dopri5", 5, pair, lower_triangular(6, A5), np.array(B5), error=np.array([ERROR5]))
    source = "Dormand and Prince; Hairer, Norsett and Wanner, Solving ODEs I, II.10"
    errors = np.array([ERROR8_5, ERROR8_3])
    return (
        euler,
        rk4,
        dopri5,
        Explicit("dop853", 8, source, lower_triangular(12, A8), np.array(B8), errors, adaptive=True),
    )
