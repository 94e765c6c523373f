"""Gauss collocation of one or two stages, solved by a fixed number of Newton iterations."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.kernels.implicit import DIAGONAL, FROZEN_ITERATIONS, GAUSS_NODE, LOWER, RELAXATION, REMAINDER
from flexman_gym.kernels.layout import step_method
from flexman_gym.simulation.methods.coefficients import LINEARLY_IMPLICIT, eigenvalues, matrices
from flexman_gym.simulation.methods.implicit import midpoint_factors

MAX_CORRECTION = 1.6  # dimensionless; beyond 27/16 the corrected midpoint rule is unstable at omega h = sqrt(2)
MAX_ITERATIONS = 1000  # Newton iterations of a step with a fixed number


@dataclass(frozen=True, eq=False)
class IteratedGauss:
    """Gauss collocation with one stage (the midpoint rule) or two, solved by a fixed number of Newton iterations.

    The iterations use the approximate Jacobian of the linearly implicit methods; an evaluation of either costs the
    same.

    Attributes:
        name, order, source: see the module.
        iterations: Newton iterations of a step; each evaluates every stage.
        stages: 1 or 2.
        correction: coefficient a of the correction force a h^2 K w of the midpoint rule, with stiffness matrix K and
            filtered accelerations w, see `kernels.implicit`; 1/6 gives order 4 for undamped vibrations, 0 none.

    Raises:
        ValueError: for fewer than 1 iteration, another number of stages, too few iterations for the order, or a
            correction with one iteration, with two stages or outside of [0, 1.6]. Each iteration raises the order by
            one: from 1 to 2 with one stage, from 2 to 4 with two stages.
    """

    name: str
    order: int
    source: str
    iterations: int
    stages: int = 1
    correction: float = 0.0
    kind = LINEARLY_IMPLICIT
    adaptive = False
    estimates = False
    in_lanes = True  # several arms share the vector registers of a step
    first_step = 0

    def __post_init__(self) -> None:
        whole_number(f"{self.name}.iterations", self.iterations, 1, MAX_ITERATIONS)
        whole_number(f"{self.name}.stages", self.stages, 1, 2)
        if not 0.0 <= finite(f"{self.name}.correction", self.correction) <= MAX_CORRECTION:
            raise value_error(f"{self.name}.correction", self.correction, f"a number from 0 to {MAX_CORRECTION}")
        if self.correction and (self.stages > 1 or self.iterations < 2):
            raise value_error(f"{self.name}.correction", self.correction, "0 with two stages or with one iteration")
        most = min(self.iterations + self.stages - 1, 2 * self.stages)
        if not 1 <= self.order <= most:
            raise ValueError(
                f"{self.name}: is not of order {self.order}: {self.iterations} iterations give at most {most}"
            )

    @property
    def evaluations(self) -> int:
        """Evaluations of the accelerations in a step."""
        return self.iterations if self.stages == 1 else 2 * self.iterations + 1

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """Argument `method` of the kernels."""
        if self.stages > 1:
            return step_method(gauss=self.iterations)
        return step_method(midpoint=(self.iterations, float(self.correction)))

    @property
    def step_cost(self) -> float:
        """Processor time of a step, in lanes, / that of an evaluation with a matrix factorisation."""
        return 0.7 * self.evaluations

    def amplification(self, angle: Array) -> NDArray[np.complex128]:
        """Return the factors (..., f) of a step of an undamped vibration, for its phase (...), rad, in a step."""
        if self.stages > 1:
            return _pair_factors(self.iterations, angle)
        return _corrected_factors(self.correction, angle) if self.correction else midpoint_factors(angle)


def _corrected_factors(correction: float, angle: Array) -> NDArray[np.complex128]:
    """Return the factors of the corrected midpoint rule: eigenvalues of one step for q, h v; q'' = -omega^2 q."""
    w = corrected_acceleration(correction, angle)
    return eigenvalues(matrices([[1.0 + 0.5 * w, 1.0 + 0.25 * w], [w, 1.0 + 0.5 * w]]))


def corrected_acceleration(correction: float, angle: Array) -> Array:
    """Return the acceleration (...) times h^2 of a step of the corrected midpoint rule, for q + h v / 2 = 1."""
    u = 0.25 * angle**2
    result: Array = -4.0 * u / (1.0 + u) * (1.0 + 4.0 * correction * u / (1.0 + u) ** 3)
    return result


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
    return eigenvalues(matrices([list(row) for row in zip(*ends, strict=True)]))
