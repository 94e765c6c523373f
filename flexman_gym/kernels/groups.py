"""Groups: lanes loaded from arrays and stored into them, neighbours of one arm or numbers of several (see `lanes`)."""

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from flexman_gym.kernels.lanes import INDEX, NEIGHBOURS, NUMBER, Lanes, instruction_of, joint_kind, spread
from flexman_gym.kernels.layout import LANES


def _group(flat: Any) -> Any:
    """What a place of a flat array of one arm's or several arms' numbers gives when groups are asked for."""
    if isinstance(flat.dtype, Lanes) or not flat.mutable:
        return flat.dtype
    return NEIGHBOURS


@intrinsic
def group_size(typing_context, flat):
    """How many neighbours of a flat array are one group."""
    size = LANES if _group(flat) == NEIGHBOURS else 1

    def generate(context, builder, kinds, values):
        return context.get_constant(types.intp, size)

    return types.intp(flat), generate


def _place(context: Any, builder: Any, kinds: Any, flat: Any, i: Any) -> tuple[Any, int]:
    """Where the group at place i is, and how it is aligned."""
    data = builder.gep(context.make_array(kinds.args[0])(context, builder, flat).data, [i])
    kind = _group(kinds.args[0])
    if kind == NEIGHBOURS:
        return builder.bitcast(data, kind.vector.as_pointer()), 8
    return data, 8 * kind.width if isinstance(kind, Lanes) else 8


@intrinsic
def load_lanes(typing_context, flat, i):
    """The group that starts at place i >= 0 of a flat array."""

    def generate(context, builder, kinds, values):
        place, alignment = _place(context, builder, kinds, *values)
        return builder.load(place, align=alignment)

    return _group(flat)(flat, types.intp), generate


@intrinsic
def pick_lanes(typing_context, flat, i, stride):
    """The group of the numbers at place i >= 0 of a flat array and every stride from there on."""
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
    """The group from place i >= 0 of a flat array on = a."""

    def generate(context, builder, kinds, values):
        place, alignment = _place(context, builder, kinds, *values[:2])
        builder.store(spread(context, builder, kinds.args[2], _group(flat), values[2]), place, align=alignment)
        return context.get_dummy_value()

    return types.void(flat, types.intp, a), generate


@intrinsic
def spread_lanes(typing_context, flat, i, stride, a):
    """The numbers at place i >= 0 of a flat array and every stride from there on = those of the group a."""

    def generate(context, builder, kinds, values):
        data, place = context.make_array(kinds.args[0])(context, builder, values[0]).data, values[1]
        group = spread(context, builder, kinds.args[3], _group(flat), values[3])
        if _group(flat) != NEIGHBOURS:
            builder.store(group, builder.gep(data, [place]))
            return context.get_dummy_value()
        for k in range(LANES):
            builder.store(builder.extract_element(group, _index(k)), builder.gep(data, [place]))
            place = builder.add(place, values[2])
        return context.get_dummy_value()

    return types.void(flat, types.intp, types.intp, a), generate


@intrinsic
def add_rows(typing_context, total, factors, rows, j, stride):
    """total + the sum of the factors, groups, times as many groups of rows, from place j on every stride.

    Factors and arrays of rows are tuples: first all of them at the first number of a group, then at the next one.
    """
    kind = joint_kind(total, *factors, *map(_group, rows))
    size = LANES if any(_group(each) == NEIGHBOURS for each in rows) else 1

    def generate(context, builder, kinds, values):
        sum_, place = spread(context, builder, kinds.args[0], kind, values[0]), values[3]
        groups = zip(kinds.args[1], cgutils.unpack_tuple(builder, values[1]), strict=True)
        groups = [spread(context, builder, each, kind, value) for each, value in groups]
        arrays = zip(kinds.args[2], cgutils.unpack_tuple(builder, values[2]), strict=True)
        arrays = [(each, context.make_array(each)(context, builder, value).data) for each, value in arrays]
        for k in range(size):
            for factor, (flat, data) in zip(groups, arrays, strict=True):
                pointer = builder.gep(data, [place])
                if size == LANES:
                    factor = spread(context, builder, NUMBER, kind, builder.extract_element(factor, _index(k)))
                    row = builder.load(builder.bitcast(pointer, kind.vector.as_pointer()), align=8)
                else:
                    row = spread(context, builder, _group(flat), kind, builder.load(pointer))
                sum_ = instruction_of(builder, "fma", kind, [factor, row, sum_])
            place = builder.add(place, values[4])
        return sum_

    return kind(total, factors, rows, types.intp, types.intp), generate


@intrinsic
def add_products(typing_context, total, a, b):
    """total + a b, group times group; of neighbours the sum over the group, one after the other."""
    kind = joint_kind(a, b)
    result = NUMBER if kind == NEIGHBOURS else joint_kind(total, a, b)

    def generate(context, builder, kinds, values):
        total, kinds_, values_ = spread(context, builder, kinds.args[0], result, values[0]), kinds.args[1:], values[1:]
        if kind != NEIGHBOURS:
            factors = [spread(context, builder, each, result, v) for each, v in zip(kinds_, values_, strict=True)]
            return instruction_of(builder, "fma", result, [*factors, total])
        factors = [spread(context, builder, each, kind, v) for each, v in zip(kinds_, values_, strict=True)]
        for k in range(LANES):
            parts = [builder.extract_element(each, _index(k)) for each in factors]
            total = instruction_of(builder, "fma", NUMBER, [*parts, total])
        return total

    return result(total, a, b), generate


@intrinsic
def lane_number(typing_context, flat, i, k):
    """Number k of the group at place i of a flat array of arms abreast."""

    def generate(context, builder, kinds, values):
        return builder.load(_lane(context, builder, kinds, *values))

    return NUMBER(flat, types.intp, types.intp), generate


@intrinsic
def store_lane_number(typing_context, flat, i, k, value):
    """Number k of the group at place i of a flat array of arms abreast = value."""

    def generate(context, builder, kinds, values):
        builder.store(values[3], _lane(context, builder, kinds, *values[:3]))
        return context.get_dummy_value()

    return types.void(flat, types.intp, types.intp, NUMBER), generate


def _lane(context: Any, builder: Any, kinds: Any, flat: Any, i: Any, k: Any) -> Any:
    place = builder.gep(context.make_array(kinds.args[0])(context, builder, flat).data, [i])
    return builder.gep(builder.bitcast(place, ir.DoubleType().as_pointer()), [k])


def _index(k: int) -> Any:
    return ir.Constant(INDEX, k)
