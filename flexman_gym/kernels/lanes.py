"""Lanes: numbers that kernels add and multiply at once, each in one instruction of the processor.

Written out as a type because the compiler does not find such groups by itself: Numba keeps its search for them off.
The lanes of `NEIGHBOURS` are neighbours in an array of one arm, those of `ARMS` the same number of several arms, and
those of `SEQUENCES` that number in several sequences of an extrapolated step of one arm. Kernels are written once for
all: where the arrays of work space hold `ARMS` or `SEQUENCES`, a group of neighbours is one element, and the constants
that they share are read-only arrays of plain numbers.
"""

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

from flexman_gym.kernels.layout import ARMS_ABREAST, LANES

INDEX = ir.IntType(32)


class Lanes(types.Type):
    """Numba's name for such a group; calculates with another one or with a number, which all lanes then share."""

    def __init__(self, width: int, of: str) -> None:
        super().__init__(name=f"Lanes({width}, {of})")
        self.width = width
        self.vector = ir.VectorType(ir.DoubleType(), width)

    def unify(self, typing_context: Any, other: Any) -> Any:
        """A variable that is a number here and a group there is a group."""
        return self if other == NUMBER else None

    def can_convert_from(self, typing_context: Any, other: Any) -> Any:
        """Numbers become groups where one is wanted."""
        return Conversion.safe if other == NUMBER else None


NUMBER, NEIGHBOURS, ARMS = types.float64, Lanes(LANES, "neighbours"), Lanes(ARMS_ABREAST, "arms")
SEQUENCES = Lanes(LANES, "sequences")


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """A group is one vector register, or a few."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


@lower_cast(types.Float, Lanes)
def spread(context: Any, builder: Any, kind: Any, target: Any, value: Any) -> Any:
    """The group that repeats a number; a group, and a number where one is wanted, stay as they are."""
    if kind == target:
        return value
    undefined = ir.Constant(target.vector, ir.Undefined)
    one = builder.insert_element(undefined, value, ir.Constant(INDEX, 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(INDEX, target.width), [0] * target.width))


def joint_kind(*kinds: Any) -> Any:
    """The type of what is calculated from these: the one group among numbers, None for other types."""
    groups = {kind for kind in kinds if isinstance(kind, Lanes)}
    if len(groups) > 1 or any(kind not in groups and kind != NUMBER for kind in kinds):
        return None
    return groups.pop() if groups else NUMBER


class LanesArithmetic(AbstractTemplate):
    """The types of sums, differences, products, quotients and functions."""

    def generic(self, args: Any, kws: Any) -> Any:
        """A group, if an argument is one and the others are numbers or of the same kind."""
        kind = joint_kind(*args)
        return signature(kind, *args) if isinstance(kind, Lanes) else None


def instruction_of(builder: Any, name: str, kind: Any, operands: Any) -> Any:
    """One of the compiler's own functions, of numbers or groups."""
    element, suffix = (kind.vector, f"v{kind.width}f64") if isinstance(kind, Lanes) else (ir.DoubleType(), "f64")
    function = ir.FunctionType(element, [element] * len(operands))
    return builder.call(cgutils.get_or_insert_function(builder.module, function, f"llvm.{name}.{suffix}"), operands)


def _declare(symbol: Callable) -> None:
    infer_global(symbol)(type("LanesArithmetic", (LanesArithmetic,), {"key": symbol}))


def _operator(symbol: Callable, instruction: str) -> None:
    """Lets compiled code use an operator of Python between groups."""
    _declare(symbol)

    def lower(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
        pairs = zip(kinds.args, values, strict=True)
        operands = [spread(context, builder, kind, kinds.return_type, value) for kind, value in pairs]
        return getattr(builder, instruction)(*operands)

    for operands in ((Lanes, Lanes), (Lanes, types.Float), (types.Float, Lanes)):
        lower_builtin(symbol, *operands)(lower)


for _name, _symbols in {
    "fadd": (operator.add, operator.iadd),
    "fsub": (operator.sub, operator.isub),
    "fmul": (operator.mul, operator.imul),
    "fdiv": (operator.truediv, operator.itruediv),
}.items():
    for _symbol in _symbols:
        _operator(_symbol, _name)

for _function in (operator.neg, math.sqrt, math.sin, math.cos, math.tanh):
    _declare(_function)


@lower_builtin(operator.neg, Lanes)
def _negative(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return builder.fneg(values[0])


@lower_builtin(math.sqrt, Lanes)
def _root(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return instruction_of(builder, "sqrt", kinds.return_type, values)


def _one_by_one(symbol: Callable) -> None:
    """A function of the mathematical library, which knows single numbers only."""

    @lower_builtin(symbol, Lanes)
    def lower(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
        function = context.get_function(symbol, NUMBER(NUMBER))
        group = values[0]
        for k in range(kinds.return_type.width):
            place = ir.Constant(INDEX, k)
            group = builder.insert_element(group, function(builder, [builder.extract_element(values[0], place)]), place)
        return group


for _single in (math.sin, math.cos, math.tanh):
    _one_by_one(_single)


@intrinsic
def fused(typing_context, a, b, c):
    """a b + c, rounded once; written out, as the compiler would fuse differently for one arm and for several."""
    kind = joint_kind(a, b, c)

    def generate(context, builder, kinds, values):
        pairs = zip(kinds.args, values, strict=True)
        operands = [spread(context, builder, each, kind, value) for each, value in pairs]
        return instruction_of(builder, "fma", kind, operands)

    return kind(a, b, c), generate


def _all(builder: Any, kind: Any, condition: Any) -> Any:
    """Whether a condition holds in every lane."""
    if not isinstance(kind, Lanes):
        return condition
    bits = ir.IntType(kind.width)
    return builder.icmp_unsigned("==", builder.bitcast(condition, bits), ir.Constant(bits, 2**kind.width - 1))


@intrinsic
def vanishes(typing_context, a):
    """Whether a number, or every lane of a group, is zero."""

    def generate(context, builder, kinds, values):
        zero = spread(context, builder, NUMBER, kinds.args[0], ir.Constant(ir.DoubleType(), 0.0))
        return _all(builder, kinds.args[0], builder.fcmp_ordered("==", values[0], zero))

    return types.boolean(a), generate


@intrinsic
def below(typing_context, a, limit):
    """Whether a number, or every lane of a group, is less than a limit."""

    def generate(context, builder, kinds, values):
        kind = kinds.args[0]
        bound = spread(context, builder, NUMBER, kind, values[1])
        return _all(builder, kind, builder.fcmp_ordered("<", values[0], bound))

    return types.boolean(a, NUMBER), generate


@intrinsic
def choose_below(typing_context, a, limit, near, far):
    """Lane by lane, near where a is less than a limit, far where it is not."""
    kind = joint_kind(a, limit, near, far)

    def generate(context, builder, kinds, values):
        pairs = zip(kinds.args, values, strict=True)
        a, bound, near, far = (spread(context, builder, each, kind, value) for each, value in pairs)
        return builder.select(builder.fcmp_ordered("<", a, bound), near, far)

    return kind(a, limit, near, far), generate
