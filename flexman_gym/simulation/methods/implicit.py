"""Implicit midpoint rule and generalised-alpha methods, solved by Newton's method until it converges."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, positive
from flexman_gym.common.errors import value_error
from flexman_gym.kernels.layout import GeneralisedAlpha, step_method
from flexman_gym.simulation.methods.coefficients import IMPLICIT, eigenvalues, matrices


@dataclass(frozen=True, eq=False)
class Implicit:
    """Generalised-alpha method, or the implicit midpoint rule, solved by Newton's method until it converges.

    Attributes:
        name, order, source: see the module.
        radius: spectral radius at infinite frequency, from 1 (no numerical damping) to 0 (the largest damping); None
            for the midpoint rule.
        tolerance: largest relative error of the solution of a step, > 0.
        evaluations: typical number of evaluations of the accelerations in a step.
    """

    name: str
    order: int
    source: str
    radius: float | None = None
    tolerance: float = 1e-10
    kind = IMPLICIT
    adaptive = False
    estimates = False
    evaluations = 5
    in_lanes = False  # Newton iterations of an arm end when they have converged
    step_cost = 0.0  # not estimated

    def __post_init__(self) -> None:
        positive(f"{self.name}.tolerance", self.tolerance)
        if self.radius is not None and not 0.0 <= finite(f"{self.name}.radius", self.radius) <= 1.0:
            raise value_error(f"{self.name}.radius", self.radius, "a number from 0 to 1")

    @property
    def first_step(self) -> int:
        """Index of the first step of an integration: -1, a step of length zero, for generalised-alpha, else 0."""
        return 0 if self.radius is None else -1

    @property
    def coefficients(self) -> GeneralisedAlpha:
        """Coefficients in the form of the kernels."""
        if self.radius is None:
            return GeneralisedAlpha(0.0, 0.0, 0.0, 0.0, True, self.tolerance)
        mass, force = (2.0 * self.radius - 1.0) / (self.radius + 1.0), self.radius / (self.radius + 1.0)
        gamma = 0.5 - mass + force
        return GeneralisedAlpha(mass, force, 0.25 * (gamma + 0.5) ** 2, gamma, False, self.tolerance)

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """Argument `method` of the kernels."""
        return step_method(converged=self.coefficients)

    def amplification(self, angle: Array) -> NDArray[np.complex128]:
        """Return the factors (..., f) of a step of an undamped vibration, for its phase (...), rad, in a step."""
        if self.radius is None:
            return midpoint_factors(angle)
        alpha_m, alpha_f, beta, gamma = self.coefficients[:4]
        square = angle**2
        # For q, h v, h^2 a: (1 - alpha_m) a1 + alpha_m a = -omega^2 ((1 - alpha_f) q1 + alpha_f q); Newmark's q1, v1.
        last: list[Any] = [(1.0 - alpha_f) * square, 0.0, 1.0 - alpha_m]
        after: list[list[Any]] = [[1.0, 0.0, -beta], [0.0, 1.0, -gamma], last]
        before: list[list[Any]] = [[1.0, 1.0, 0.5 - beta], [0.0, 1.0, 1.0 - gamma], [-alpha_f * square, 0.0, -alpha_m]]
        return eigenvalues(np.linalg.solve(matrices(after), matrices(before)))


def midpoint_factors(angle: Array) -> NDArray[np.complex128]:
    """Return the factor (..., 1) of the midpoint rule, of which one iteration is exact for a linear problem."""
    return ((1.0 + 0.5j * angle) / (1.0 - 0.5j * angle))[..., None]


def generalised_alpha(radius: float) -> Implicit:
    """Return the generalised-alpha method with a given spectral radius at infinite frequency.

    Args:
        radius: from 1 (no numerical damping) to 0 (the largest damping).

    Examples:
        >>> method = fm.generalised_alpha(0.8)
        >>> method.name, method.order, method.radius
        ('generalised_alpha', 2, 0.8)
        >>> fm.simulate(fm.catalog.paper_scene("rr"), method=method, step=0.01).status
        'ok'
    """
    source = "Chung and Hulbert 1993; Arnold and Bruls 2007, Multibody System Dynamics 18, 185"
    return Implicit("generalised_alpha", 2, source, radius)
