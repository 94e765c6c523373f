"""Families: explicit, linearly implicit and implicit methods as data that checks itself.

Every method has a name (for `simulate`), an order of convergence in the step, a source of its coefficients and a `kind`
("explicit", "linearly implicit", "implicit" or "reference"). It says whether it is `adaptive`: it always chooses its
steps by rtol and atol. It says whether it `estimates` its error, so that it can choose its steps.

Source of the conditions of order: Hairer, Norsett and Wanner (Solving ODEs I, II.1), Hairer and Wanner (II, IV.7).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import finite, instance, refusal, whole_number
from flexman_gym.kernels.layout import SEQUENCES, STAGES, Averages, Tableau

EXPLICIT, LINEARLY_IMPLICIT, IMPLICIT, REFERENCE = "explicit", "linearly implicit", "implicit", "reference"
KINDS = (EXPLICIT, LINEARLY_IMPLICIT, IMPLICIT, REFERENCE)
ROUNDING = 1e-12
MOST_SWEEPS = 1000


def _none() -> Array:
    return np.zeros((0, 0))


@dataclass(frozen=True, eq=False)
class Explicit:
    """A Runge-Kutta method with s stages: k_i = f(y + h sum_j a_ij k_j); a step adds h sum b_i k_i.

    Attributes:
        name, order, source: see the top of this file.
        a: (s, s) strictly lower triangular.
        b: (s,).
        error: (e, s + 1) weights of e = 0, 1 or 2 error estimates; the last column weighs the slope after the step.
        semi_implicit: whether positions follow the speeds after the step instead of those before it.
        adaptive: whether it is a reference, which always chooses its steps.

    Raises:
        ValueError: when the coefficients contradict each other or the order (checked to order 4).
    """

    name: str
    order: int
    source: str
    a: Array
    b: Array
    error: Array = field(default_factory=_none)
    semi_implicit: bool = False
    adaptive: bool = False

    def __post_init__(self) -> None:
        _check_stages(self.name, self.a, self.b, self.error)
        _check_order(self.name, self.order, self.conditions)

    @property
    def kind(self) -> str:
        """Kind: explicit, or reference."""
        return REFERENCE if self.adaptive else EXPLICIT

    @property
    def estimates(self) -> bool:
        """Whether it knows its error."""
        return bool(self.error.size)

    @property
    def conditions(self) -> list[tuple[int, str, float]]:
        """Order, name and residual of the conditions of order 1 to 4."""
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
        """The coefficients as the kernels read them."""
        s = len(self.b)
        error = self.error if self.error.size else np.zeros((0, s + 1))
        exponent = 8 if len(error) == 2 else self.order
        once, one = np.ones(1, dtype=np.int64), np.ones(1)
        abscissae = np.append(self.a.sum(axis=1), 1.0)
        rest = (self.semi_implicit, once, one, one - one)
        return Tableau(self.a, self.b, np.zeros((s, s)), abscissae, error, 0.0, exponent, *rest)


@dataclass(frozen=True, eq=False)
class LinearlyImplicit:
    """A W-method with s stages and an approximate Jacobian A, or its extrapolation.

    (1 - gamma h A) k_i = f(y + h sum_j a_ij k_j) + h A sum_{j<i} coupling_ij k_j; a step adds h sum b_i k_i. An
    extrapolation takes a step of a method of order 1 in each number of parts in `sequence`. It then eliminates as many
    powers of the step as the number of these results allows.

    Attributes:
        name, order, source: see the top of this file.
        a: (s, s) strictly lower triangular.
        b: (s,).
        gamma: the diagonal factor of the Jacobian, > 0.
        coupling: (s, s) strictly lower triangular factors of the Jacobian.
        error: (e, s) weights of e = 0 or 1 error estimates.
        sequence: ascending numbers of parts.

    Raises:
        ValueError: when the coefficients contradict each other or the order. Order is checked to 2, for every Jacobian;
            each sequence of an extrapolation adds an order.
    """

    name: str
    order: int
    source: str
    a: Array
    b: Array
    gamma: float
    coupling: Array
    error: Array = field(default_factory=_none)
    sequence: tuple[int, ...] = (1,)
    kind = LINEARLY_IMPLICIT
    adaptive = False

    def __post_init__(self) -> None:
        s, parts = len(self.b), self.sequence
        with_last_column = np.hstack([self.error, np.zeros((len(self.error), 1))]) if self.error.size else self.error
        _check_stages(self.name, self.a, self.b, with_last_column)
        if self.coupling.shape != (s, s) or np.triu(self.coupling).any() or not self.gamma > 0.0:
            raise ValueError(f"{self.name}: coupling must be strictly lower triangular, {s} x {s}, and gamma positive")
        single = len(parts) == 1
        if list(parts) != sorted({*parts}) or min(parts) < 1 or len(parts) > SEQUENCES or (single and parts != (1,)):
            raise ValueError(f"{self.name}: sequence must be 1, or up to {SEQUENCES} ascending numbers of parts")
        if not single and s != 1:
            raise ValueError(f"{self.name}: only a method of one stage is extrapolated")
        _check_order(self.name, self.order, self.conditions)

    @property
    def estimates(self) -> bool:
        """Whether it knows its error."""
        return bool(self.error.size) or len(self.sequence) > 1

    @property
    def evaluations(self) -> int:
        """Evaluations a step."""
        return len(self.b) * sum(self.sequence)

    @property
    def conditions(self) -> list[tuple[int, str, float]]:
        """Order, name and residual of the conditions; they hold with `coupling` in place of `a` too."""
        b, ones = self.b, np.ones(len(self.b))
        first = (1, "sum b - 1", float(b @ ones - 1))
        if len(self.sequence) > 1:
            return [first, (1, "sequences - order", float(len(self.sequence) - self.order))]
        second = (2, "b c - 1/2", float(b @ self.a @ ones - 1 / 2))
        return [first, second, (2, "b Gamma 1", float(b @ (self.coupling @ ones + self.gamma)))]

    @property
    def tableau(self) -> Tableau:
        """The coefficients as the kernels read them, in the transformed variables."""
        s, parts = len(self.b), np.array(self.sequence, dtype=np.int64)
        weights = extrapolation_weights(self.sequence)
        lower = np.append(0.0, extrapolation_weights(self.sequence[1:])) if len(parts) > 1 else weights
        inverse = np.linalg.inv(self.gamma * np.eye(s) + self.coupling)
        error = (self.error if self.error.size else np.zeros((0, s))) @ inverse
        c = np.eye(s) / self.gamma - inverse
        abscissae = np.append(self.a.sum(axis=1), 1.0)
        rest = (self.gamma, self.order, False, parts, weights, weights - lower)
        return Tableau(self.a @ inverse, self.b @ inverse, c, abscissae, error, *rest)


@dataclass(frozen=True, eq=False)
class Implicit:
    """The generalised-alpha method, or, without a radius, the midpoint rule, solved by Newton's method.

    Attributes:
        name, order, source: see the top of this file.
        radius: spectral radius at infinite frequency, from 1 (no numerical damping) to 0 (the most); None for the
            midpoint rule.

    Raises:
        ValueError: for a radius that is not from 0 to 1.
    """

    name: str
    order: int
    source: str
    radius: float | None = None
    kind = IMPLICIT
    adaptive = False
    estimates = False

    def __post_init__(self) -> None:
        if self.radius is not None and not 0.0 <= finite(f"{self.name}.radius", self.radius) <= 1.0:
            raise refusal(f"{self.name}.radius", self.radius, "a number from 0 to 1")

    @property
    def averages(self) -> Averages:
        """The coefficients as the kernels read them."""
        if self.radius is None:
            return Averages(0.0, 0.0, 0.0, 0.0, True)
        mass, force = (2.0 * self.radius - 1.0) / (self.radius + 1.0), self.radius / (self.radius + 1.0)
        gamma = 0.5 - mass + force
        return Averages(mass, force, 0.25 * (gamma + 0.5) ** 2, gamma, False)


@dataclass(frozen=True, eq=False)
class Sweeps:
    """Gauss's collocation with one stage (the midpoint rule) or two, by a fixed number of iterations a step.

    Their approximate Jacobian is that of a linearly implicit method, and so are cost and failures.

    Attributes:
        name, order, source: see the top of this file.
        sweeps: iterations, each an evaluation of every stage.
        stages: 1 or 2.

    Raises:
        ValueError: for sweeps < 1, other stages, or too few sweeps for the order. Each gains one: from 1 to 2 with one
            stage, from 2 to 4 with two.
    """

    name: str
    order: int
    source: str
    sweeps: int
    stages: int = 1
    kind = LINEARLY_IMPLICIT
    adaptive = False
    estimates = False

    def __post_init__(self) -> None:
        whole_number(f"{self.name}.sweeps", self.sweeps, 1, MOST_SWEEPS)
        whole_number(f"{self.name}.stages", self.stages, 1, 2)
        most = min(self.sweeps + self.stages - 1, 2 * self.stages)
        if not 1 <= self.order <= most:
            raise ValueError(f"{self.name}: is not of order {self.order}: {self.sweeps} sweeps gain {most} at most")

    @property
    def evaluations(self) -> int:
        """Evaluations a step."""
        return self.sweeps if self.stages == 1 else 2 * self.sweeps + 1

    @property
    def counts(self) -> tuple[int, int | None]:
        """The sweeps as the kernels take them, see `swept_step`."""
        return self.sweeps, None if self.stages == 1 else self.stages


@dataclass(frozen=True, eq=False)
class Outside:
    """A reference that SciPy's integrator of the same name computes.

    Attributes:
        name, order, source: see the top of this file.
    """

    name: str
    order: int
    source: str
    kind = REFERENCE
    adaptive = True
    estimates = True


Method = Explicit | LinearlyImplicit | Implicit | Sweeps | Outside


def extrapolation_weights(sequence: Sequence[int]) -> Array:
    """Gives the weights of an extrapolation (Neville).

    They eliminate the powers 1, 2, ... of the step from its results.

    Args:
        sequence: ascending numbers of parts of the step, one for each result.
    """
    return np.array([math.prod(n / (n - m) for m in sequence if m != n) for n in sequence], dtype=float)


def _check_stages(name: str, a: Array, b: Array, error: Array) -> None:
    for part, value in (("a", a), ("b", b), ("error", error)):
        instance(f"{name}.{part}", value, np.ndarray, "an array")
    s = len(b)
    if a.shape != (s, s) or np.triu(a).any() or not 0 < s < STAGES:
        raise ValueError(f"{name}: a must be strictly lower triangular, {s} x {s}, with 0 < s < {STAGES}")
    if error.size and error.shape not in ((1, s + 1), (2, s + 1)):
        raise ValueError(f"{name}: error must be 1 or 2 rows of weights, one for each of {s} stages")


def _check_order(name: str, order: int, conditions: list[tuple[int, str, float]]) -> None:
    for least, condition, residual in conditions:
        if least <= order and not abs(residual) <= ROUNDING:
            raise ValueError(f"{name}: is not of order {order}: {condition} is off by {residual:.3g}")
