"""Integration methods as data: explicit, linearly implicit and implicit families, and the table of all methods by name.

Every method has a name (for `simulate`), an order of convergence in the step, a source of its coefficients and a `kind`
("explicit", "linearly implicit", "implicit" or "reference"). A method with `adaptive` set always chooses its steps by
rtol and atol; a method with `estimates` set can do so. The constructors check coefficients against the order.

Order conditions: Hairer, Norsett and Wanner, Solving ODEs I, II.1, and Hairer and Wanner, Solving ODEs II, IV.7. Pairs
of Dormand and Prince of order 5 (1980) and order 8 (DOP853): Solving ODEs I, II.5 and II.10, with the appendix. SciPy
has the same coefficients, but its import is slow. Rows of A5 and A8 omit trailing zeros.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, instance, positive, value_error, whole_number
from flexman_gym.common.registry import Registry
from flexman_gym.kernels.layout import MAX_SEQUENCES, MAX_STAGES, GeneralisedAlpha, Tableau

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


EXPLICIT, LINEARLY_IMPLICIT, IMPLICIT, REFERENCE = "explicit", "linearly implicit", "implicit", "reference"
KINDS = (EXPLICIT, LINEARLY_IMPLICIT, IMPLICIT, REFERENCE)
ORDER_TOLERANCE = 1e-12  # dimensionless; largest residual of an order condition: rounding of its sum
MAX_CORRECTION = 1.6  # dimensionless; beyond 27/16 the corrected midpoint rule is unstable at omega h = sqrt(2)
MAX_ITERATIONS = 1000  # Newton iterations of a step with a fixed number


def _no_error_weights() -> Array:
    return np.zeros((0, 0))


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
    error: Array = field(default_factory=_no_error_weights)
    semi_implicit: bool = False
    adaptive: bool = False

    def __post_init__(self) -> None:
        _check_stages(self.name, self.a, self.b, self.error)
        _check_order(self.name, self.order, self.conditions)

    @property
    def kind(self) -> str:
        """Family of the method: "explicit", or "reference" for an adaptive one."""
        return REFERENCE if self.adaptive else EXPLICIT

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
    error: Array = field(default_factory=_no_error_weights)
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
        if (
            list(parts) != sorted({*parts})
            or min(parts) < 1
            or len(parts) > MAX_SEQUENCES
            or (single and parts != (1,))
        ):
            raise ValueError(f"{self.name}: sequence must be 1, or up to {MAX_SEQUENCES} ascending numbers of substeps")
        if not single and s != 1:
            raise ValueError(f"{self.name}: only a method of one stage can be extrapolated")
        _check_order(self.name, self.order, self.conditions)

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

    def __post_init__(self) -> None:
        positive(f"{self.name}.tolerance", self.tolerance)
        if self.radius is not None and not 0.0 <= finite(f"{self.name}.radius", self.radius) <= 1.0:
            raise value_error(f"{self.name}.radius", self.radius, "a number from 0 to 1")

    @property
    def coefficients(self) -> GeneralisedAlpha:
        """Coefficients in the form of the kernels."""
        if self.radius is None:
            return GeneralisedAlpha(0.0, 0.0, 0.0, 0.0, True, self.tolerance)
        mass, force = (2.0 * self.radius - 1.0) / (self.radius + 1.0), self.radius / (self.radius + 1.0)
        gamma = 0.5 - mass + force
        return GeneralisedAlpha(mass, force, 0.25 * (gamma + 0.5) ** 2, gamma, False, self.tolerance)


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
    def counts(self) -> tuple[int, float | None, None]:
        """Iterations and correction (None for two stages) in the form of the kernels, see `fixed_newton_step`."""
        return self.iterations, None if self.stages > 1 else float(self.correction), None


@dataclass(frozen=True, eq=False)
class ScipyMethod:
    """Reference method computed by the integrator of the same name in SciPy.

    Attributes:
        name, order, source: see the module.
    """

    name: str
    order: int
    source: str
    kind = REFERENCE
    adaptive = True
    estimates = True


FixedStepMethod = LinearlyImplicit | IteratedGauss | Explicit | Implicit  # methods of the kernel `batch._fixed_step`
Method = FixedStepMethod | ScipyMethod


def _extrapolation_weights(sequence: Sequence[int]) -> Array:
    """Return the weights (m,) of m results with these numbers of substeps in an extrapolation to step zero (Neville).

    Their sum eliminates the powers 1, 2, ..., m - 1 of the step from the error.
    """
    return np.array([math.prod(n / (n - m) for m in sequence if m != n) for n in sequence], dtype=float)


def _check_stages(name: str, a: Array, b: Array, error: Array) -> None:
    for part, value in (("a", a), ("b", b), ("error", error)):
        instance(f"{name}.{part}", value, np.ndarray, "an array")
    s = len(b)
    if a.shape != (s, s) or np.triu(a).any() or not 0 < s < MAX_STAGES:
        raise ValueError(f"{name}: a must be strictly lower triangular, {s} x {s}, with 0 < s < {MAX_STAGES}")
    if error.size and error.shape not in ((1, s + 1), (2, s + 1)):
        raise ValueError(f"{name}: error must be 1 or 2 rows of weights, one for each of {s} stages")


def _check_order(name: str, order: int, conditions: list[tuple[int, str, float]]) -> None:
    for least, condition, residual in conditions:
        if least <= order and not abs(residual) <= ORDER_TOLERANCE:
            raise ValueError(f"{name}: is not of order {order}: {condition} is off by {residual:.3g}")


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


def _lower_triangular(size: int, rows: Sequence[Sequence[float]]) -> Array:
    matrix = np.zeros((size, size))
    for i, row in enumerate(rows, start=1):
        matrix[i, : len(row)] = row
    return matrix


def _explicit_methods() -> tuple[Explicit, ...]:
    euler = Explicit(
        "semi_implicit_euler", 1, "symplectic Euler: Hairer, Lubich and Wanner, Geometric Numerical "
        "Integration, I.1", np.zeros((1, 1)), np.ones(1), semi_implicit=True,
    )  # fmt: skip
    third = _lower_triangular(4, [[0.5], [0.0, 0.5], [0.0, 0.0, 1.0]])
    rk4 = Explicit("rk4", 4, "Kutta 1901", third, np.array([1, 2, 2, 1]) / 6)
    pair = "Dormand and Prince 1980; Hairer, Norsett and Wanner, Solving ODEs I, II.5"
    dopri5 = Explicit("dopri5", 5, pair, _lower_triangular(6, A5), np.array(B5), error=np.array([ERROR5]))
    source = "Dormand and Prince; Hairer, Norsett and Wanner, Solving ODEs I, II.10"
    errors = np.array([ERROR8_5, ERROR8_3])
    return (
        euler,
        rk4,
        dopri5,
        Explicit("dop853", 8, source, _lower_triangular(12, A8), np.array(B8), errors, adaptive=True),
    )


def _linearly_implicit_methods() -> tuple[LinearlyImplicit, ...]:
    gamma = 1 - math.sqrt(0.5)  # L-stable
    ros2 = LinearlyImplicit(
        name="ros2",
        order=2,
        source="Verwer, Spee, Blom and Hundsdorfer 1999, SIAM J. Sci. Comput. 20, 1456",
        a=_lower_triangular(2, [[1.0]]),
        b=np.array([0.5, 0.5]),
        gamma=gamma,
        coupling=_lower_triangular(2, [[-2 * gamma]]),
        error=np.array([[-0.5, 0.5]]),  # difference from the solution of the first stage
    )
    source = "Deuflhard 1985, SIAM Review 27, 505; Hairer and Wanner, Solving ODEs II, IV.9"
    one, zero = np.ones(1), np.zeros((1, 1))
    return ros2, *(
        LinearlyImplicit(f"extrapolated_euler_{n}", n, source, zero, one, 1.0, zero,
                         sequence=tuple(range(1, n + 1))) for n in range(3, 9)
    )  # fmt: skip


def _implicit_methods() -> tuple[Method, ...]:
    source = "Hairer, Lubich and Wanner, Geometric Numerical Integration, II.1"
    midpoint = Implicit("implicit_midpoint", 2, source)
    iterated = [IteratedGauss(f"midpoint_{n}", 2, f"{source}; Newton's iterations: VIII.6", n) for n in (2, 3)]
    corrected = f"{source}; Stormer and Cowell's correction: Hairer, Norsett and Wanner, Solving ODEs I, III.10"
    iterated += [IteratedGauss(f"midpoint_corrected_{n}", 2, corrected, n, correction=1 / 6) for n in (2, 3)]
    pairs = f"{source}; van der Houwen and Swart 1997, SIAM J. Sci. Comput. 18, 41"
    iterated += [IteratedGauss(f"gauss_{n}", n + 1, pairs, n, 2) for n in (2, 3)]
    radau = ScipyMethod("radau", 5, "Hairer and Wanner, Solving ODEs II, IV.8; the integrator of SciPy")
    return midpoint, *iterated, generalised_alpha(0.9), radau


DEFAULT_METHOD = "midpoint_corrected_3"  # method of fixed steps where none is named


class _Methods(Registry[Method]):
    """Integration methods by name, for `fm.simulate(scene, method=name, step=...)`.

    Each Method has an `order` (the error at a given time falls with the step to this power), a `kind` ("explicit",
    "linearly implicit", "implicit" or "reference") and a `source`. All of them run with a fixed `step` (s), except the
    methods of kind "reference", for which `step` is the length of the first step. Reference methods, and methods with
    an error estimate when no step is given, choose their steps by `rtol` and `atol` (rad, m, and their rates). `flexman
    list methods` prints the table.

    Examples:
        >>> fm.METHODS["midpoint_3"].order, fm.METHODS["midpoint_3"].kind
        (2, 'linearly implicit')
        >>> [name for name, method in fm.METHODS.items() if method.kind == "reference"]
        ['dop853', 'radau']
    """


METHODS = _Methods(
    "method",
    {method.name: method for method in (*_explicit_methods(), *_linearly_implicit_methods(), *_implicit_methods())},
)
"""Integration methods by name."""
