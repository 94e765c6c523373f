"""Synchronisation of two threads by two flags in shared memory, with busy waiting."""

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from flexman_gym.kernels.compile import released

FLAG_SIZE = 8  # bytes; size of an int64


@intrinsic
def _load_acquire(typing_context, flags, index):
    """Return flags[index] with acquire order: values stored before its release by another thread are visible."""

    def generate(context, builder, signature, values):
        return builder.load_atomic(_address(context, builder, signature, values), "acquire", FLAG_SIZE)

    return types.int64(flags, index), generate


@intrinsic
def _store_release(typing_context, flags, index, value):
    """Set flags[index] with release order: all earlier stores are visible to a thread that reads the value."""

    def generate(context, builder, signature, values):
        builder.store_atomic(values[2], _address(context, builder, signature, values), "release", FLAG_SIZE)
        return context.get_dummy_value()

    return types.void(flags, types.int64, types.int64), generate


def _address(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    """Return the address of an entry of a contiguous array of int64."""
    data = context.make_array(signature.args[0])(context, builder, values[0]).data
    index = context.cast(builder, values[1], signature.args[1], types.int64)
    return builder.gep(builder.bitcast(data, ir.IntType(64).as_pointer()), [index])


@released
def spin_wait(flags, own, value, expected, max_polls):
    """Set the flag of this thread, then wait until the flag of the other thread has the expected value.

    Args:
        flags: (2,) int64, one flag for each thread.
        own: index of this thread's flag, 0 or 1.
        value: new value of this thread's flag.
        expected: value of the other flag that ends the wait.
        max_polls: number of reads after which the wait ends without success.

    Returns:
        True if the other flag had the expected value, else False.
    """
    _store_release(flags, own, value)
    for _ in range(max_polls):
        if _load_acquire(flags, 1 - own) == expected:
            return True
    return False
