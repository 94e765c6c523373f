"""Linearly implicit methods (W-methods) and their extrapolations.

Order conditions: Hairer and Wanner, Solving ODEs II, IV.7.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.kernels.layout import MAX_SEQUENCES, Tableau, step_method
from flexman_gym.simulation.methods.coefficients import (
    LINEARLY_IMPLICIT,
    check_order,
    check_stages,
    lower_triangular,
    no_error_weights,
    stability_function,
)


@dataclass(frozen=True, eq=False)
class LinearlyImplicit:
    """W-method with s stages and an approximate Jacobian A, or the extrapolation of such a method.

    (1 - gamma h A) k_i = f(y + h sum_j a_ij k_j) + h A sum_{j<i} coupling_ij k_j; a step adds h sum b_i k_i. An
    extrapolation divides the step into each number of substeps in `sequence`, integrates them by a method of order 1,
    and combines the results so that the leading powers of the step cancel in the error.

    Attributes:
        name, order, source: see the module.
        a: (s, s) strictly lower triangular.
        b: (s,) weights.
        gamma: diagonal coefficient of the Jacobian, > 0.
        coupling: (s, s) strictly lower triangular coefficients of the Jacobian.
        error: (e, s) weights of e = 0 or 1 error estimates.
        sequence: ascending numbers of substeps; (1,) without extrapolation.

    Raises:
        ValueError: for inconsistent coefficients or an order they do not have. The order is checked up to 2, for any
            Jacobian; each further number in the sequence of an extrapolation adds an order.
    """

    name: str
    order: int
    source: str
    a: Array
    b: Array
    gamma: float
    coupling: Array
    error: Array = field(default_factory=no_error_weights)
    sequence: tuple[int, ...] = (1,)
    kind = LINEARLY_IMPLICIT
    adaptive = False
    in_lanes = True  # several arms share the vector registers of a step
    first_step = 0

    def __post_init__(self) -> None:
        s, parts = len(self.b), self.sequence
        with_last_column = np.hstack([self.error, np.zeros((len(self.error), 1))]) if self.error.size else self.error
        check_stages(self.name, self.a, self.b, with_last_column)
        if self.coupling.shape != (s, s) or np.triu(self.coupling).any() or not self.gamma > 0.0:
            raise ValueError(f"{self.name}: coupling must be strictly lower triangular, {s} x {s}, and gamma positive")
        single = len(parts) == 1
        if (
            list(parts) != sorted({*parts})
            or min(parts) < 1
            or len(parts) > MAX_SEQUENCES
            or (single and parts != (1,))
        ):
            raise ValueError(f"{self.name}: sequence must be 1, or up to {MAX_SEQUENCES} ascending numbers of substeps")
        if not single and s != 1:
            raise ValueError(f"{self.name}: only a method of one stage can be extrapolated")
        check_order(self.name, self.order, self.conditions)

    @property
    def estimates(self) -> bool:
        """Availability of an error estimate."""
        return bool(self.error.size) or len(self.sequence) > 1

    @property
    def evaluations(self) -> int:
        """Evaluations of the accelerations in a step."""
        return len(self.b) * sum(self.sequence)

    @property
    def conditions(self) -> list[tuple[int, str, float]]:
        """Order conditions: (order, name, residual). They also hold with `coupling` in place of `a`."""
        b, ones = self.b, np.ones(len(self.b))
        first = (1, "sum b - 1", float(b @ ones - 1))
        if len(self.sequence) > 1:
            return [first, (1, "sequences - order", float(len(self.sequence) - self.order))]
        second = (2, "b c - 1/2", float(b @ self.a @ ones - 1 / 2))
        return [first, second, (2, "b Gamma 1", float(b @ (self.coupling @ ones + self.gamma)))]

    @property
    def tableau(self) -> Tableau:
        """Coefficients in the form of the kernels, for the transformed stages."""
        s, parts = len(self.b), np.array(self.sequence, dtype=np.int64)
        weights = _extrapolation_weights(self.sequence)
        lower = np.append(0.0, _extrapolation_weights(self.sequence[1:])) if len(parts) > 1 else weights
        inverse = np.linalg.inv(self.gamma * np.eye(s) + self.coupling)
        error = (self.error if self.error.size else np.zeros((0, s))) @ inverse
        c = np.eye(s) / self.gamma - inverse
        abscissae = np.append(self.a.sum(axis=1), 1.0)
        rest = (self.gamma, self.order, False, parts, weights, weights - lower)
        return Tableau(self.a @ inverse, self.b @ inverse, c, abscissae, error, *rest)

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """Argument `method` of the kernels."""
        return step_method(linearly_implicit=self.tableau)

    @property
    def step_cost(self) -> float:
        """Processor time of a step, in lanes, / that of an evaluation with a matrix factorisation."""
        return 0.7 * len(self.b) * max(self.sequence)

    def amplification(self, angle: Array) -> NDArray[np.complex128]:
        """Return the factors (..., f) of a step of an undamped vibration, for its phase (...), rad, in a step."""
        matrix = self.a + self.coupling + self.gamma * np.eye(len(self.b))
        result = np.zeros(angle.shape, dtype=np.complex128)
        for weight, parts in zip(self.tableau.weights, self.sequence, strict=True):
            result += weight * stability_function(matrix, self.b, 1j * angle / parts) ** parts
        return result[..., None]


def _extrapolation_weights(sequence: Sequence[int]) -> Array:
    """Return the weights (m,) of m results with these numbers of substeps in an extrapolation to step zero (Neville).

    Their sum eliminates the powers 1, 2, ..., m - 1 of the step from the error.
    """
    return np.array([math.prod(n / (n - m) for m in sequence if m != n) for n in sequence], dtype=float)


def linearly_implicit_methods() -> tuple[LinearlyImplicit, ...]:
    """Return the methods of this family."""
    gamma = 1 - math.sqrt(0.5)  # L-stable
    ros2 = LinearlyImplicit(
        name="ros2",
        order=2,
        source="Verwer, Spee, Blom and Hundsdorfer 1999, SIAM J. Sci. Comput. 20, 1456",
        a=lower_triangular(2, [[1.0]]),
        b=np.array([0.5, 0.5]),
        gamma=gamma,
        coupling=lower_triangular(2, [[-2 * gamma]]),
        error=np.array([[-0.5, 0.5]]),  # difference from the solution of the first stage
    )
    source = "Deuflhard 1985, SIAM Review 27, 505; Hairer and Wanner, Solving ODEs II, IV.9"
    one, zero = np.ones(1), np.zeros((1, 1))
    return ros2, *(
        LinearlyImplicit(f"extrapolated_euler_{n}", n, source, zero, one, 1.0, zero,
                         sequence=tuple(range(1, n + 1))) for n in range(3, 9)
    )  # fmt: skip
