"""Methods: integrators as data that checks itself."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from flexman_gym.kernels.layout import SEQUENCES, STAGES, Averages, Tableau
from flexman_gym.simulation.dormand_prince import A5, A8, B5, B8, ERROR5, ERROR8_3, ERROR8_5

EXPLICIT, LINEARLY_IMPLICIT, IMPLICIT, REFERENCE = "explicit", "linearly implicit", "implicit", "reference"
KINDS = (EXPLICIT, LINEARLY_IMPLICIT, IMPLICIT, REFERENCE)
ROUNDING = 1e-12


def _none() -> NDArray[np.float64]:
    return np.zeros((0, 0))


@dataclass(frozen=True, eq=False)
class Method:
    """A one-step method with s stages.

    k_i = f(y + h sum_j a_ij k_j) for an explicit one, (1 - gamma h A) k_i = f(y + h sum_j a_ij k_j) + h A sum_{j<i}
    coupling_ij k_j for a linearly implicit one with approximate Jacobian A; the step adds h sum b_i k_i. Extrapolation
    of a linearly implicit method of order 1 takes it in each number of parts in `sequence` and eliminates as many
    powers of the step as that allows. An implicit one is the generalised-alpha method, or, without `radius`, the
    midpoint rule.

    Attributes:
        name: the name that `simulate` takes.
        order: of convergence, in the step.
        kind: "explicit", "linearly implicit", "implicit" or "reference" (always adaptive).
        source: where the coefficients come from.
        a: (s, s) strictly lower triangular.
        b: (s,).
        gamma, coupling: diagonal and (s, s) strictly lower triangular part that multiplies the Jacobian.
        error: (e, s + 1) weights of e = 0, 1 or 2 error estimates; the last column weighs the slope after the step, 0
            for a linearly implicit one.
        sequence: ascending numbers of parts.
        semi_implicit: places follow the speeds after the step instead of those before it.
        radius: spectral radius at infinite frequency, 1 without and 0 with the most numerical damping.

    Raises:
        ValueError: when the coefficients contradict each other or the order (checked to order 4; to 2 for a W-method).
    """

    name: str
    order: int
    kind: str
    source: str
    a: NDArray[np.float64] = field(default_factory=_none)
    b: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    gamma: float = 0.0
    coupling: NDArray[np.float64] | None = None
    error: NDArray[np.float64] = field(default_factory=_none)
    sequence: tuple[int, ...] = (1,)
    semi_implicit: bool = False
    radius: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"{self.name}: kind {self.kind!r} is not allowed; give one of {', '.join(KINDS)}")
        s = len(self.b)
        if self.a.shape != (s, s) or np.triu(self.a).any() or s >= STAGES:
            raise ValueError(f"{self.name}: a must be strictly lower triangular, {s} x {s}, with s < {STAGES}")
        if (self.gamma != 0.0) != (self.kind == LINEARLY_IMPLICIT):
            raise ValueError(f"{self.name}: gamma must be given for a linearly implicit method, and for no other")
        if self.coupling_matrix.shape != (s, s) or np.triu(self.coupling_matrix).any() or self.gamma < 0.0:
            raise ValueError(f"{self.name}: coupling must be strictly lower triangular, {s} x {s}, and gamma positive")
        if self.error.size and self.error.shape not in ((1, s + 1), (2, s + 1)):
            raise ValueError(f"{self.name}: error must be 1 or 2 rows of {s + 1} weights")
        if (s == 0) != (self.kind == IMPLICIT or self.by_scipy):
            raise ValueError(f"{self.name}: a {self.kind} method has stages, an implicit one none")
        if self.radius is not None and not (self.kind == IMPLICIT and 0.0 <= self.radius <= 1.0):
            raise ValueError(f"{self.name}: radius must be from 0 to 1, and given for an implicit method only")
        parts, single = self.sequence, len(self.sequence) == 1
        if list(parts) != sorted({*parts}) or min(parts) < 1 or len(parts) > SEQUENCES or (single and parts != (1,)):
            raise ValueError(f"{self.name}: sequence must be 1, or up to {SEQUENCES} ascending numbers of parts")
        if not single and (self.kind != LINEARLY_IMPLICIT or s != 1):
            raise ValueError(f"{self.name}: only a linearly implicit method of one stage is extrapolated")
        for condition, residual in order_conditions(self):
            if not abs(residual) <= ROUNDING:
                raise ValueError(f"{self.name}: is not of order {self.order}: {condition} is off by {residual:.3g}")

    @property
    def adaptive(self) -> bool:
        """Whether the method always chooses its steps by rtol and atol."""
        return self.kind == REFERENCE

    @property
    def estimates(self) -> bool:
        """Whether the method knows its error, so that it can choose its steps."""
        return self.adaptive or bool(self.error.size) or len(self.sequence) > 1

    @property
    def by_scipy(self) -> bool:
        """Whether SciPy's integrator of that name does the work."""
        return self.kind == REFERENCE and len(self.b) == 0

    @property
    def tableau(self) -> Tableau:
        """The coefficients as the kernels read them."""
        s, abscissae = len(self.b), np.append(self.a.sum(axis=1), 1.0)
        error = self.error if self.error.size else np.zeros((0, s + 1))
        parts = np.array(self.sequence, dtype=np.int64)
        weights = extrapolation_weights(self.sequence)
        lower = np.append(0.0, extrapolation_weights(self.sequence[1:])) if len(parts) > 1 else weights
        shared = (self.semi_implicit, parts, weights, weights - lower)
        if self.kind != LINEARLY_IMPLICIT:
            exponent = 8 if len(error) == 2 else self.order
            return Tableau(self.a, self.b, np.zeros((s, s)), abscissae, error, 0.0, exponent, *shared)
        inverse = np.linalg.inv(self.gamma * np.eye(s) + self.coupling_matrix)
        c = np.eye(s) / self.gamma - inverse
        error = error[:, :s] @ inverse
        return Tableau(self.a @ inverse, self.b @ inverse, c, abscissae, error, self.gamma, self.order, *shared)

    @property
    def averages(self) -> Averages:
        """The coefficients of an implicit step as the kernels read them."""
        if self.radius is None:
            return Averages(0.0, 0.0, 0.0, 0.0, True)
        mass, force = (2.0 * self.radius - 1.0) / (self.radius + 1.0), self.radius / (self.radius + 1.0)
        gamma = 0.5 - mass + force
        return Averages(mass, force, 0.25 * (gamma + 0.5) ** 2, gamma, False)

    @property
    def coupling_matrix(self) -> NDArray[np.float64]:
        """(s, s) strictly lower triangular part that multiplies the Jacobian; zero for an explicit method."""
        return np.zeros_like(self.a) if self.coupling is None else self.coupling


def extrapolation_weights(sequence: Sequence[int]) -> NDArray[np.float64]:
    """Weights that eliminate the powers 1, 2, ... of the step from results in these numbers of parts (Neville)."""
    return np.array([math.prod(n / (n - m) for m in sequence if m != n) for n in sequence], dtype=float)


def order_conditions(method: Method) -> list[tuple[str, float]]:
    """Order conditions of Hairer, Norsett and Wanner (Solving ODEs I, II.1; II, IV.7) with their residuals.

    A W-method must meet them for every Jacobian, so that each condition also holds with `coupling` in place of `a`.
    Each sequence of an extrapolation adds an order.
    """
    a, b = method.a, method.b
    if len(b) == 0:
        return []
    if len(method.sequence) > 1:
        return [("sum b - 1", float(b.sum() - 1)), ("sequences - order", float(len(method.sequence) - method.order))]
    ones = np.ones(len(b))
    c = a @ ones
    conditions = [(1, "sum b - 1", b @ ones - 1), (2, "b c - 1/2", b @ c - 1 / 2)]
    if method.kind == LINEARLY_IMPLICIT:
        conditions.append((2, "b Gamma 1", b @ (method.coupling_matrix @ ones + method.gamma)))
    else:
        conditions += [
            (3, "b c^2 - 1/3", b @ c**2 - 1 / 3),
            (3, "b a c - 1/6", b @ a @ c - 1 / 6),
            (4, "b c^3 - 1/4", b @ c**3 - 1 / 4),
            (4, "b c a c - 1/8", (b * c) @ a @ c - 1 / 8),
            (4, "b a c^2 - 1/12", b @ a @ c**2 - 1 / 12),
            (4, "b a a c - 1/24", b @ a @ a @ c - 1 / 24),
        ]
    return [(name, float(residual)) for order, name, residual in conditions if order <= method.order]


def generalised_alpha(radius: float) -> Method:
    """The generalised-alpha method with a spectral radius at infinite frequency from 0 to 1."""
    source = "Chung and Hulbert 1993; Arnold and Bruls 2007, Multibody System Dynamics 18, 185"
    return Method("generalised_alpha", 2, IMPLICIT, source, radius=radius)


def _lower(size: int, rows: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    matrix = np.zeros((size, size))
    for i, row in enumerate(rows, start=1):
        matrix[i, : len(row)] = row
    return matrix


def _explicit() -> tuple[Method, ...]:
    euler = Method(
        "semi_implicit_euler", 1, EXPLICIT, "symplectic Euler: Hairer, Lubich and Wanner, Geometric Numerical "
        "Integration, I.1", np.zeros((1, 1)), np.ones(1), semi_implicit=True,
    )  # fmt: skip
    third = _lower(4, [[0.5], [0.0, 0.5], [0.0, 0.0, 1.0]])
    rk4 = Method("rk4", 4, EXPLICIT, "Kutta 1901", third, np.array([1, 2, 2, 1]) / 6)
    pair = "Dormand and Prince 1980; Hairer, Norsett and Wanner, Solving ODEs I, II.5"
    dopri5 = Method("dopri5", 5, EXPLICIT, pair, _lower(6, A5), np.array(B5), error=np.array([ERROR5]))
    source = "Dormand and Prince; Hairer, Norsett and Wanner, Solving ODEs I, II.10"
    errors = np.array([ERROR8_5, ERROR8_3])
    return euler, rk4, dopri5, Method("dop853", 8, REFERENCE, source, _lower(12, A8), np.array(B8), error=errors)


def _linearly_implicit() -> tuple[Method, ...]:
    gamma = 1 - math.sqrt(0.5)  # L-stable
    ros2 = Method(
        name="ros2",
        order=2,
        kind=LINEARLY_IMPLICIT,
        source="Verwer, Spee, Blom and Hundsdorfer 1999, SIAM J. Sci. Comput. 20, 1456",
        a=_lower(2, [[1.0]]),
        b=np.array([0.5, 0.5]),
        gamma=gamma,
        coupling=_lower(2, [[-2 * gamma]]),
        error=np.array([[-0.5, 0.5, 0.0]]),  # against the first stage alone
    )
    source = "Deuflhard 1985, SIAM Review 27, 505; Hairer and Wanner, Solving ODEs II, IV.9"
    one = np.ones(1)
    return ros2, *(
        Method(f"extrapolated_euler_{n}", n, LINEARLY_IMPLICIT, source, np.zeros((1, 1)), one, 1.0,
               sequence=tuple(range(1, n + 1))) for n in (3, 4, 5)
    )  # fmt: skip


def _implicit() -> tuple[Method, ...]:
    midpoint = Method(
        "implicit_midpoint", 2, IMPLICIT, "Hairer, Lubich and Wanner, Geometric Numerical Integration, II.1"
    )
    radau = Method("radau", 5, REFERENCE, "Hairer and Wanner, Solving ODEs II, IV.8; the integrator of SciPy")
    return midpoint, generalised_alpha(0.9), radau


METHODS: dict[str, Method] = {method.name: method for method in (*_explicit(), *_linearly_implicit(), *_implicit())}
