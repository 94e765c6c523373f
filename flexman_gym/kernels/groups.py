"""Groups: lanes loaded from arrays and stored into them, neighbours of one arm or numbers of several (see `lanes`)."""

from typing import Any

from llvmlite import ir
from numba.core import types
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
            group = builder.insert_element(group, builder.load(builder.gep(data, [place])), ir.Constant(INDEX, k))
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
            builder.store(builder.extract_element(group, ir.Constant(INDEX, k)), builder.gep(data, [place]))
            place = builder.add(place, values[2])
        return context.get_dummy_value()

    return types.void(flat, types.intp, types.intp, a), generate


@intrinsic
def add_rows(typing_context, total, factors, rows, j, stride):
    """total + the sum of the factors, a group, times as many groups of rows, from place j on every stride."""
    kind = joint_kind(total, factors, _group(rows))

    def generate(context, builder, kinds, values):
        sum_, factors, array, place, step = values
        sum_ = spread(context, builder, kinds.args[0], kind, sum_)
        if _group(rows) == NEIGHBOURS:
            picked = [builder.extract_element(factors, ir.Constant(INDEX, k)) for k in range(LANES)]
            picked = [spread(context, builder, NUMBER, kind, each) for each in picked]
        else:
            picked = [spread(context, builder, kinds.args[1], kind, factors)]
        data = context.make_array(rows)(context, builder, array).data
        for factor in picked:
            pointer = builder.gep(data, [place])
            if _group(rows) == NEIGHBOURS:
                row = builder.load(builder.bitcast(pointer, kind.vector.as_pointer()), align=8)
            else:
                row = spread(context, builder, _group(rows), kind, builder.load(pointer))
            sum_ = instruction_of(builder, "fma", kind, [factor, row, sum_])
            place = builder.add(place, step)
        return sum_

    return kind(total, factors, rows, types.intp, types.intp), generate


@intrinsic
def sum_lanes(typing_context, a):
    """The sum of a group of neighbours; what is no such group is its own sum."""
    result = NUMBER if a == NEIGHBOURS else a

    def generate(context, builder, kinds, values):
        if a != NEIGHBOURS:
            return values[0]
        part = [builder.extract_element(values[0], ir.Constant(INDEX, k)) for k in range(LANES)]
        halves = builder.fadd(part[0], part[2]), builder.fadd(part[1], part[3])
        return builder.fadd(*halves)

    return result(a), generate
