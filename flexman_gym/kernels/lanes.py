"""Groups of LANES numbers that kernels add and multiply at once, each in one instruction of the processor.

Written out as a type because the compiler does not find such groups by itself: Numba keeps its search for them off.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from flexman_gym.kernels.linalg import LANES, inner

FLAGS = ("contract", "reassoc", "nsz", "arcp")  # those of `linalg`
GROUP = ir.VectorType(ir.DoubleType(), LANES)
INDEX = ir.IntType(32)


class Lanes(types.Type):
    """Numba's name for such a group; adds, subtracts and multiplies with another one or with a number."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


LANES_TYPE = Lanes()


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """A group is one vector register."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, GROUP)


class LanesArithmetic(AbstractTemplate):
    """The types of sums, differences and products."""

    def generic(self, args: Any, kws: Any) -> Any:
        """A group, if one of the two is a group and the other a group or a number."""
        if len(args) == 2 and LANES_TYPE in args and all(each in (LANES_TYPE, types.float64) for each in args):
            return signature(LANES_TYPE, *args)
        return None


def _spread(builder: Any, kind: Any, value: Any) -> Any:
    """A group; of a number, the group that repeats it."""
    if kind == LANES_TYPE:
        return value
    undefined, first = ir.Constant(GROUP, ir.Undefined), ir.Constant(INDEX, 0)
    one = builder.insert_element(undefined, value, first)
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(INDEX, LANES), [0] * LANES))


def _define(symbol: Callable, instruction: str) -> None:
    """Lets compiled code use an operator of Python between groups."""
    infer_global(symbol)(type("LanesArithmetic", (LanesArithmetic,), {"key": symbol}))

    def lower(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
        operands = [_spread(builder, kind, value) for kind, value in zip(kinds.args, values, strict=True)]
        return getattr(builder, instruction)(*operands, flags=FLAGS)

    for kinds in ((Lanes, Lanes), (Lanes, types.Float), (types.Float, Lanes)):
        lower_builtin(symbol, *kinds)(lower)


_define(operator.add, "fadd")
_define(operator.iadd, "fadd")
_define(operator.sub, "fsub")
_define(operator.isub, "fsub")
_define(operator.mul, "fmul")


def _place(context: Any, builder: Any, kind: Any, flat: Any, i: Any) -> Any:
    data = context.make_array(kind)(context, builder, flat).data
    return builder.bitcast(builder.gep(data, [i]), GROUP.as_pointer())


@intrinsic
def load_lanes(typing_context, flat, i):
    """The group that starts at place i >= 0 of a flat array."""

    def generate(context, builder, kinds, values):
        return builder.load(_place(context, builder, kinds.args[0], *values), align=8)

    return LANES_TYPE(flat, types.intp), generate


@intrinsic
def pick_lanes(typing_context, flat, i, stride):
    """The group of the numbers at place i >= 0 of a flat array and every stride from there on."""

    def generate(context, builder, kinds, values):
        data = context.make_array(kinds.args[0])(context, builder, values[0]).data
        group, place = ir.Constant(GROUP, ir.Undefined), values[1]
        for k in range(LANES):
            group = builder.insert_element(group, builder.load(builder.gep(data, [place])), ir.Constant(INDEX, k))
            place = builder.add(place, values[2])
        return group

    return LANES_TYPE(flat, types.intp, types.intp), generate


@intrinsic
def store_lanes(typing_context, flat, i, a):
    """The group from place i >= 0 of a flat array on = a."""

    def generate(context, builder, kinds, values):
        builder.store(values[2], _place(context, builder, kinds.args[0], *values[:2]), align=8)
        return context.get_dummy_value()

    return types.void(flat, types.intp, LANES_TYPE), generate


@intrinsic
def all_lanes(typing_context, value):
    """The group that repeats a number."""

    def generate(context, builder, kinds, values):
        return _spread(builder, types.float64, values[0])

    return LANES_TYPE(types.float64), generate


@intrinsic
def lane(typing_context, a, index):
    """Number `index`, a constant, of a group."""

    def generate(context, builder, kinds, values):
        return builder.extract_element(values[0], ir.Constant(INDEX, index.literal_value))

    if isinstance(index, types.Literal):
        return types.float64(a, index), generate
    return None


@inner
def sum_lanes(a):
    """The sum of a group."""
    return (lane(a, 0) + lane(a, 2)) + (lane(a, 1) + lane(a, 3))


@inner
def add_rows(total, factors, rows, j, stride):
    """total + the sum of LANES factors, a group, times as many groups of rows, from place j on every stride."""
    total = total + lane(factors, 0) * load_lanes(rows, j) + lane(factors, 1) * load_lanes(rows, j + stride)
    total = total + lane(factors, 2) * load_lanes(rows, j + 2 * stride)
    return total + lane(factors, 3) * load_lanes(rows, j + 3 * stride)
