"""SIMD groups of float64 as a Numba type, with arithmetic, comparisons, loads and stores.

The kernels need an explicit type because Numba turns automatic vectorisation off. The lanes of a `NEIGHBOURS` group
are neighbouring entries of an array of one arm, those of an `ARMS` group one entry for several arms, and those of a
`SEQUENCES` group one entry for several sequences: the integrations of one extrapolated step with different numbers of
substeps. A `TANGENTS` group is an entry of one arm and its derivatives with respect to seven parameters, see
`tangents`. A kernel has one source for all four: in scratch arrays of `ARMS`, `SEQUENCES` or `TANGENTS` groups, each
element is a group, a load of neighbours returns one element, and constants shared by the lanes are read-only arrays
of numbers.
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

from flexman_gym.kernels.layout import ARMS_PER_GROUP, LANES
from flexman_gym.kernels.tangents import Tangents

INDEX = ir.IntType(32)


class Lanes(types.Type):
    """Numba type of a group of numbers; arithmetic combines a group with a group of the same type or a number."""

    def __init__(self, width: int, of: str) -> None:
        super().__init__(name=f"Lanes({width}, {of})")
        self.width = width
        self.vector = ir.VectorType(ir.DoubleType(), width)

    def unify(self, typing_context: Any, other: Any) -> Any:
        """Return this type for a variable that is a number in one branch and a group in another."""
        return self if other == NUMBER else None

    def can_convert_from(self, typing_context: Any, other: Any) -> Any:
        """Allow the conversion of a number to a group."""
        return Conversion.safe if other == NUMBER else None


NUMBER, NEIGHBOURS, ARMS = types.float64, Lanes(LANES, "neighbours"), Lanes(ARMS_PER_GROUP, "arms")
SEQUENCES, TANGENTS = Lanes(LANES, "sequences"), Lanes(ARMS_PER_GROUP, "tangents")


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    """Data model: a group is one vector register or a few."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


@lower_cast(types.Float, Lanes)
def _broadcast(context: Any, builder: Any, kind: Any, target: Any, value: Any) -> Any:
    """Return a number as a group with equal lanes or with derivatives of zero, and a group unchanged."""
    if kind == target:
        return value
    if target == TANGENTS:
        return Tangents(builder).from_number(value)
    undefined = ir.Constant(target.vector, ir.Undefined)
    one = builder.insert_element(undefined, value, ir.Constant(INDEX, 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(INDEX, target.width), [0] * target.width))


def _factor(context: Any, builder: Any, kind: Any, target: Any, value: Any) -> Any:
    """Return a number as a group, as `_broadcast`; with tangents a number, by which tangents are scaled."""
    return value if target == TANGENTS else _broadcast(context, builder, kind, target, value)


def _common_type(*kinds: Any) -> Any:
    """Return the type of a result: the only group type among the arguments, NUMBER without groups, None otherwise."""
    groups = {kind for kind in kinds if isinstance(kind, Lanes)}
    if len(groups) > 1 or any(kind not in groups and kind != NUMBER for kind in kinds):
        return None
    return groups.pop() if groups else NUMBER


class _LanesArithmetic(AbstractTemplate):
    """Type inference of operators and functions of groups."""

    def generic(self, args: Any, kws: Any) -> Any:
        """Return the signature if the arguments are groups of one type, or such groups and numbers."""
        kind = _common_type(*args)
        return signature(kind, *args) if isinstance(kind, Lanes) else None


def _call_instruction(builder: Any, name: str, kind: Any, operands: Any) -> Any:
    """Return the call of an LLVM intrinsic function, fma or sqrt, on numbers or groups."""
    if kind == TANGENTS:
        groups = Tangents(builder)
        return groups.multiply_add(*operands) if name == "fma" else groups.square_root(*operands)
    element, suffix = (kind.vector, f"v{kind.width}f64") if isinstance(kind, Lanes) else (ir.DoubleType(), "f64")
    function = ir.FunctionType(element, [element] * len(operands))
    return builder.call(cgutils.get_or_insert_function(builder.module, function, f"llvm.{name}.{suffix}"), operands)


def _declare(symbol: Callable) -> None:
    infer_global(symbol)(type("LanesArithmetic", (_LanesArithmetic,), {"key": symbol}))


# instructions with a rule of their own for tangents
PRODUCTS = {"fmul": Tangents.multiply, "fdiv": Tangents.divide}


def _operator(symbol: Callable, instruction: str) -> None:
    """Define a Python operator between groups in compiled code."""
    _declare(symbol)

    def lower(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
        pairs = zip(kinds.args, values, strict=True)
        if kinds.return_type == TANGENTS and instruction in PRODUCTS:
            return PRODUCTS[instruction](Tangents(builder), *values)
        operands = [_broadcast(context, builder, kind, kinds.return_type, value) for kind, value in pairs]
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
    return _call_instruction(builder, "sqrt", kinds.return_type, values)


def _map_function(symbol: Callable) -> None:
    """Define a function of groups by calls of the mathematical library, one for each lane."""

    @lower_builtin(symbol, Lanes)
    def lower(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
        function = context.get_function(symbol, NUMBER(NUMBER))
        group = values[0]
        if kinds.return_type == TANGENTS:

            def call(name: Callable, number: Any) -> Any:
                return context.get_function(name, NUMBER(NUMBER))(builder, [number])

            return Tangents(builder).apply_function(symbol, call, group)
        for k in range(kinds.return_type.width):
            lane = ir.Constant(INDEX, k)
            group = builder.insert_element(group, function(builder, [builder.extract_element(values[0], lane)]), lane)
        return group


for _single in (math.sin, math.cos, math.tanh):
    _map_function(_single)


@intrinsic
def fma(typing_context, a, b, c):
    """Return a b + c with one rounding; explicit, as the compiler would fuse differently for one arm and several."""
    kind = _common_type(a, b, c)

    def generate(context, builder, kinds, values):
        pairs = zip(kinds.args, values, strict=True)
        operands = [_factor(context, builder, each, kind, value) for each, value in pairs]
        return _call_instruction(builder, "fma", kind, operands)

    return kind(a, b, c), generate


def _all(builder: Any, kind: Any, condition: Any) -> Any:
    """Return the boolean that is true if the condition holds in every lane."""
    if not isinstance(kind, Lanes):
        return condition
    bits = ir.IntType(kind.width)
    return builder.icmp_unsigned("==", builder.bitcast(condition, bits), ir.Constant(bits, 2**kind.width - 1))


@intrinsic
def is_zero(typing_context, a):
    """Return True if a number, or every lane of a group, is zero."""

    def generate(context, builder, kinds, values):
        zero = _broadcast(context, builder, NUMBER, kinds.args[0], ir.Constant(ir.DoubleType(), 0.0))
        return _all(builder, kinds.args[0], builder.fcmp_ordered("==", values[0], zero))

    return types.boolean(a), generate


@intrinsic
def is_below(typing_context, a, limit):
    """Return True if a number, or every lane of a group, is less than a limit; tangents are not compared."""

    def generate(context, builder, kinds, values):
        kind = kinds.args[0]
        if kind == TANGENTS:
            return builder.fcmp_ordered("<", Tangents(builder).value_of(values[0]), values[1])
        bound = _broadcast(context, builder, NUMBER, kind, values[1])
        return _all(builder, kind, builder.fcmp_ordered("<", values[0], bound))

    return types.boolean(a, NUMBER), generate


@intrinsic
def select_below(typing_context, a, limit, below, otherwise):
    """Return, lane by lane, `below` if a is less than the limit, else `otherwise`; tangents are not compared."""
    kind = _common_type(a, limit, below, otherwise)

    def generate(context, builder, kinds, values):
        pairs = zip(kinds.args, values, strict=True)
        a, bound, below, otherwise = (_broadcast(context, builder, each, kind, value) for each, value in pairs)
        if kind == TANGENTS:
            a, bound = Tangents(builder).value_of(a), Tangents(builder).value_of(bound)
        return builder.select(builder.fcmp_ordered("<", a, bound), below, otherwise)

    return kind(a, limit, below, otherwise), generate


@intrinsic
def number_of(typing_context, a):
    """Return the number of a group with tangents; numbers and other groups are returned unchanged."""
    kind = NUMBER if a == TANGENTS else a

    def generate(context, builder, kinds, values):
        return Tangents(builder).value_of(values[0]) if kinds.args[0] == TANGENTS else values[0]

    return kind(a), generate


@intrinsic
def chain(typing_context, value, slope, a):
    """Return a group with a number `value` and the tangents of a times a number `slope`; the value if a has none."""
    kind = TANGENTS if a == TANGENTS else value

    def generate(context, builder, kinds, values):
        return Tangents(builder).chain(*values) if kinds.args[2] == TANGENTS else values[0]

    return kind(value, slope, a), generate


def _group(flat: Any) -> Any:
    """Return the type of a group loaded from a flat array: NEIGHBOURS for mutable numbers, else the element type."""
    if isinstance(flat.dtype, Lanes) or not flat.mutable:
        return flat.dtype
    return NEIGHBOURS


@intrinsic
def group_size(typing_context, flat):
    """Return the number of neighbouring entries of a flat array in one group."""
    size = LANES if _group(flat) == NEIGHBOURS else 1

    def generate(context, builder, kinds, values):
        return context.get_constant(types.intp, size)

    return types.intp(flat), generate


def _address(context: Any, builder: Any, kinds: Any, flat: Any, i: Any) -> tuple[Any, int]:
    """Return the address of the group at index i and its alignment in bytes."""
    data = builder.gep(context.make_array(kinds.args[0])(context, builder, flat).data, [i])
    kind = _group(kinds.args[0])
    if kind == NEIGHBOURS:
        return builder.bitcast(data, kind.vector.as_pointer()), 8
    return data, 8 * kind.width if isinstance(kind, Lanes) else 8


@intrinsic
def load_lanes(typing_context, flat, i):
    """Return the group that begins at index i >= 0 of a flat array."""

    def generate(context, builder, kinds, values):
        place, alignment = _address(context, builder, kinds, *values)
        return builder.load(place, align=alignment)

    return _group(flat)(flat, types.intp), generate


@intrinsic
def gather_lanes(typing_context, flat, i, stride):
    """Return the group of the entries i, i + stride, i + 2 stride, ... of a flat array, i >= 0."""
    kind = _group(flat)

    def generate(context, builder, kinds, values):
        data, place = context.make_array(kinds.args[0])(context, builder, values[0]).data, values[1]
        if kind != NEIGHBOURS:
            return builder.load(builder.gep(data, [place]))
        group = ir.Constant(kind.vector, ir.Undefined)
        for k in range(LANES):
            group = builder.insert_element(group, builder.load(builder.gep(data, [place])), _index(k))
            place = builder.add(place, values[2])
        return group

    return kind(flat, types.intp, types.intp), generate


@intrinsic
def store_lanes(typing_context, flat, i, a):
    """Store the group a at index i >= 0 of a flat array."""

    def generate(context, builder, kinds, values):
        place, alignment = _address(context, builder, kinds, *values[:2])
        builder.store(_broadcast(context, builder, kinds.args[2], _group(flat), values[2]), place, align=alignment)
        return context.get_dummy_value()

    return types.void(flat, types.intp, a), generate


@intrinsic
def scatter_lanes(typing_context, flat, i, stride, a):
    """Store the lanes of the group a at i, i + stride, i + 2 stride, ... of a flat array, i >= 0."""

    def generate(context, builder, kinds, values):
        data, place = context.make_array(kinds.args[0])(context, builder, values[0]).data, values[1]
        group = _broadcast(context, builder, kinds.args[3], _group(flat), values[3])
        if _group(flat) != NEIGHBOURS:
            builder.store(group, builder.gep(data, [place]))
            return context.get_dummy_value()
        for k in range(LANES):
            builder.store(builder.extract_element(group, _index(k)), builder.gep(data, [place]))
            place = builder.add(place, values[2])
        return context.get_dummy_value()

    return types.void(flat, types.intp, types.intp, a), generate


@intrinsic
def add_weighted_rows(typing_context, total, factors, rows, j, stride):
    """Return total + the weighted sum of rows, which are groups at j, j + stride, ... of flat arrays.

    `factors` are groups whose lanes are the weights of consecutive rows. `factors` and `rows` are tuples of equal
    length; the first row of each array is added first, then the second row of each.
    """
    kind = _common_type(total, *factors, *map(_group, rows))
    size = LANES if any(_group(each) == NEIGHBOURS for each in rows) else 1

    def generate(context, builder, kinds, values):
        sum_, place = _broadcast(context, builder, kinds.args[0], kind, values[0]), values[3]
        groups = zip(kinds.args[1], cgutils.unpack_tuple(builder, values[1]), strict=True)
        groups = [_factor(context, builder, each, kind, value) for each, value in groups]
        arrays = zip(kinds.args[2], cgutils.unpack_tuple(builder, values[2]), strict=True)
        arrays = [(each, context.make_array(each)(context, builder, value).data) for each, value in arrays]
        for k in range(size):
            for factor, (flat, data) in zip(groups, arrays, strict=True):
                pointer = builder.gep(data, [place])
                if size == LANES:
                    factor = _broadcast(context, builder, NUMBER, kind, builder.extract_element(factor, _index(k)))
                    row = builder.load(builder.bitcast(pointer, kind.vector.as_pointer()), align=8)
                else:
                    row = _factor(context, builder, _group(flat), kind, builder.load(pointer))
                sum_ = _call_instruction(builder, "fma", kind, [factor, row, sum_])
            place = builder.add(place, values[4])
        return sum_

    return kind(total, factors, rows, types.intp, types.intp), generate


@intrinsic
def add_products(typing_context, total, a, b):
    """Return total + a b; for NEIGHBOURS, a number: `total` plus the products of all lanes, one after the other."""
    kind = _common_type(a, b)
    result = NUMBER if kind == NEIGHBOURS else _common_type(total, a, b)

    def generate(context, builder, kinds, values):
        total, kinds_, values_ = (
            _broadcast(context, builder, kinds.args[0], result, values[0]),
            kinds.args[1:],
            values[1:],
        )
        if kind != NEIGHBOURS:
            factors = [_factor(context, builder, each, result, v) for each, v in zip(kinds_, values_, strict=True)]
            return _call_instruction(builder, "fma", result, [*factors, total])
        factors = [_broadcast(context, builder, each, kind, v) for each, v in zip(kinds_, values_, strict=True)]
        for k in range(LANES):
            parts = [builder.extract_element(each, _index(k)) for each in factors]
            total = _call_instruction(builder, "fma", NUMBER, [*parts, total])
        return total

    return result(total, a, b), generate


@intrinsic
def extract_lane(typing_context, flat, i, k):
    """Return lane k of the group at index i of a flat array of groups."""

    def generate(context, builder, kinds, values):
        return builder.load(_lane(context, builder, kinds, *values))

    return NUMBER(flat, types.intp, types.intp), generate


@intrinsic
def lane_count(typing_context, flat):
    """Return the number of lanes of the elements of a flat array, 1 for numbers."""
    size = flat.dtype.width if isinstance(flat.dtype, Lanes) else 1

    def generate(context, builder, kinds, values):
        return context.get_constant(types.intp, size)

    return types.intp(flat), generate


@intrinsic
def value_lane(typing_context, flat, k):
    """Return the lane of the arm of lane k of the elements of a flat array: 0 for an arm with derivatives, else k."""
    derivatives = flat.dtype == TANGENTS

    def generate(context, builder, kinds, values):
        return context.get_constant(types.intp, 0) if derivatives else values[1]

    return types.intp(flat, types.intp), generate


@intrinsic
def insert_lane(typing_context, flat, i, k, value):
    """Set lane k of the group at index i of a flat array of groups."""

    def generate(context, builder, kinds, values):
        builder.store(values[3], _lane(context, builder, kinds, *values[:3]))
        return context.get_dummy_value()

    return types.void(flat, types.intp, types.intp, NUMBER), generate


def _lane(context: Any, builder: Any, kinds: Any, flat: Any, i: Any, k: Any) -> Any:
    place = builder.gep(context.make_array(kinds.args[0])(context, builder, flat).data, [i])
    return builder.gep(builder.bitcast(place, ir.DoubleType().as_pointer()), [k])


def _index(k: int) -> Any:
    return ir.Constant(INDEX, k)
