"""Integration methods as data: explicit, linearly implicit and implicit families, and the table of all methods by name.

Every method has a name (for `simulate`), an order of convergence in the step, a source of its coefficients and a `kind`
("explicit", "linearly implicit", "implicit" or "reference"). A method with `adaptive` set always chooses its steps by
rtol and atol; a method with `estimates` set can do so. The constructors check coefficients against the order. A method
of fixed steps has also its arguments of the kernels, its amplification factors, and the cost of a step.
"""

from dataclasses import dataclass

from flexman_gym.common.registry import Registry
from flexman_gym.simulation.methods.coefficients import EXPLICIT, IMPLICIT, KINDS, LINEARLY_IMPLICIT, REFERENCE
from flexman_gym.simulation.methods.explicit import Explicit, explicit_methods
from flexman_gym.simulation.methods.gauss import IteratedGauss
from flexman_gym.simulation.methods.implicit import Implicit, generalised_alpha
from flexman_gym.simulation.methods.linearly_implicit import LinearlyImplicit, linearly_implicit_methods

__all__ = [
    "DEFAULT_METHOD", "EXPLICIT", "IMPLICIT", "KINDS", "LINEARLY_IMPLICIT", "METHODS", "REFERENCE", "Explicit",
    "FixedStepMethod", "Implicit", "IteratedGauss", "LinearlyImplicit", "Method", "ScipyMethod", "generalised_alpha",
]  # fmt: skip


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
    in_lanes = False
    step_cost = 0.0


FixedStepMethod = LinearlyImplicit | IteratedGauss | Explicit | Implicit  # methods of the kernel `batch.fixed_step`
Method = FixedStepMethod | ScipyMethod


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
    {method.name: method for method in (*explicit_methods(), *linearly_implicit_methods(), *_implicit_methods())},
)
"""Integration methods by name."""
