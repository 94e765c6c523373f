"""Methods: integrators as data that checks itself."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from flexman_gym.kernels.layout import STAGES, Tableau

EXPLICIT, LINEARLY_IMPLICIT, REFERENCE = "explicit", "linearly implicit", "reference"
KINDS = (EXPLICIT, LINEARLY_IMPLICIT, REFERENCE)
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Method:
    """A one-step method with s stages.

    k_i = f(y + h sum_j a_ij k_j) for an explicit one, (1 - gamma h A) k_i = f(y + h sum_j a_ij k_j) + h A sum_{j<i}
    coupling_ij k_j for a linearly implicit one with approximate Jacobian A; the step adds h sum b_i k_i.

    Attributes:
        name: the name that `simulate` takes.
        order: of convergence, in the step.
        kind: "explicit", "linearly implicit" or "reference" (adaptive).
        a: (s, s) strictly lower triangular.
        b: (s,).
        gamma, coupling: diagonal and (s, s) strictly lower triangular part that multiplies the Jacobian.
        error: (e, s + 1) weights of e = 0, 1 or 2 error estimates; the last column weighs the slope after the step.
        source: where the coefficients come from.

    Raises:
        ValueError: when the coefficients contradict each other or the order (checked to order 4; to 2 for a W-method).
    """

    name: str
    order: int
    kind: str
    a: NDArray[np.float64]
    b: NDArray[np.float64]
    source: str
    gamma: float = 0.0
    coupling: NDArray[np.float64] | None = None
    error: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))

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
        if self.adaptive and self.error.shape not in ((1, s + 1), (2, s + 1)):
            raise ValueError(f"{self.name}: an adaptive method needs 1 or 2 rows of {s + 1} error weights")
        for condition, residual in order_conditions(self):
            if not abs(residual) <= ROUNDING:
                raise ValueError(f"{self.name}: is not of order {self.order}: {condition} is off by {residual:.3g}")

    @property
    def adaptive(self) -> bool:
        """Whether the method chooses its steps by rtol and atol."""
        return self.kind == REFERENCE

    @property
    def tableau(self) -> Tableau:
        """The coefficients as the kernels read them."""
        s = len(self.b)
        error = self.error if len(self.error) else np.zeros((0, s + 1))
        if self.kind != LINEARLY_IMPLICIT:
            return Tableau(self.a, self.b, np.zeros((s, s)), self.a.sum(axis=1), error, 0.0, 8)
        inverse = np.linalg.inv(self.gamma * np.eye(s) + self.coupling_matrix)
        c = np.eye(s) / self.gamma - inverse
        return Tableau(self.a @ inverse, self.b @ inverse, c, self.a.sum(axis=1), error, self.gamma, self.order)

    @property
    def coupling_matrix(self) -> NDArray[np.float64]:
        """(s, s) strictly lower triangular part that multiplies the Jacobian; zero for an explicit method."""
        return np.zeros_like(self.a) if self.coupling is None else self.coupling


def order_conditions(method: Method) -> list[tuple[str, float]]:
    """Order conditions of Hairer, Norsett and Wanner (Solving ODEs I, II.1; II, IV.7) with their residuals.

    A W-method must meet them for every Jacobian, so that each condition also holds with `coupling` in place of `a`.
    """
    a, b = method.a, method.b
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


def _lower(size: int, rows: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    matrix = np.zeros((size, size))
    for i, row in enumerate(rows, start=1):
        matrix[i, :i] = row
    return matrix


def _rk4() -> Method:
    a = _lower(4, [[0.5], [0.0, 0.5], [0.0, 0.0, 1.0]])
    return Method("rk4", 4, EXPLICIT, a, np.array([1, 2, 2, 1]) / 6, "Kutta 1901")


def _ros2() -> Method:
    gamma = 1 - np.sqrt(0.5)  # L-stable
    return Method(
        name="ros2",
        order=2,
        kind=LINEARLY_IMPLICIT,
        a=_lower(2, [[1.0]]),
        b=np.array([0.5, 0.5]),
        gamma=float(gamma),
        coupling=_lower(2, [[-2 * gamma]]),
        source="Verwer, Spee, Blom and Hundsdorfer 1999, SIAM J. Sci. Comput. 20, 1456",
    )


def _dop853() -> Method:
    return Method(
        name="dop853",
        order=8,
        kind=REFERENCE,
        a=np.array(DOP853.A[:12, :12]),
        b=np.array(DOP853.B),
        error=np.array([DOP853.E5, DOP853.E3]),
        source="Dormand and Prince; Hairer, Norsett and Wanner, Solving ODEs I, II.10; coefficients of SciPy",
    )


METHODS: dict[str, Method] = {method.name: method for method in (_rk4(), _ros2(), _dop853())}
