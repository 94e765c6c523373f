"""Synchronisation of two threads by two numbers in memory, by busy waiting."""

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from flexman_gym.kernels.compile import released

BYTES = 8  # of a number


@intrinsic
def _load_acquire(typing_context, numbers, place):
    """numbers[place] as another thread has left it by now."""

    def generate(context, builder, signature, values):
        return builder.load_atomic(_address(context, builder, signature, values), "acquire", BYTES)

    return types.int64(numbers, place), generate


@intrinsic
def _store_release(typing_context, numbers, place, value):
    """numbers[place] = value, for another thread to see together with all that was written before."""

    def generate(context, builder, signature, values):
        builder.store_atomic(values[2], _address(context, builder, signature, values), "release", BYTES)
        return context.get_dummy_value()

    return types.void(numbers, types.int64, types.int64), generate


def _address(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    """The address of an entry of a contiguous array of int64."""
    data = context.make_array(signature.args[0])(context, builder, values[0]).data
    place = context.cast(builder, values[1], signature.args[1], types.int64)
    return builder.gep(builder.bitcast(data, ir.IntType(64).as_pointer()), [place])


@released
def spin_wait(numbers, mine, told, awaited, looks):
    """Tells told as the number at place mine, 0 or 1, then looks until the other one is as awaited.

    Gives up after so many looks; returns whether it has seen that.
    """
    _store_release(numbers, mine, told)
    for _ in range(looks):
        if _load_acquire(numbers, 1 - mine) == awaited:
            return True
    return False
