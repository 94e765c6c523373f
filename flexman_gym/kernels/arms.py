"""Arms: several of one model that move side by side, each in a lane of the processor's vector registers.

One set of kernels moves one arm or ARMS_ABREAST of them: here they are compiled for work space whose elements are
groups of numbers, one for each arm. Lanes do not mix, so that an arm moves in the same way, to the last bit, whatever
its neighbours are. Constants that arms may differ in (`PER_ARM`) are such groups too, the others are shared.

A call passes addresses of arrays instead of the arrays, which takes microseconds less.
"""

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numba.np import arrayobj

from flexman_gym.kernels.lanes import ARMS, lane_number, store_lane_number
from flexman_gym.kernels.layout import (
    ARMS_ABREAST,
    DIVERGED,
    LARGEST_STATE,
    OK,
    Array,
    Constants,
    IntArray,
    Rows,
    Work,
)
from flexman_gym.kernels.linalg import kernel
from flexman_gym.kernels.outputs import observe
from flexman_gym.kernels.steppers import implicit_step

PER_ARM = frozenset(
    {
        "payload_mass", "payload_inertia", "joint_stiffness", "joint_damping", "rotor_inertia", "carried_inertia",
        "stiffness", "damping",
    }
)  # fmt: skip
ALIGNMENT = 64  # bytes; of a group of eight numbers


def arms_array(shape: tuple[int, ...]) -> Array:
    """Zeros (..., ARMS_ABREAST), aligned for vector registers."""
    count = int(np.prod(shape)) * ARMS_ABREAST
    memory = np.zeros(count + ALIGNMENT // 8)
    first = -memory.ctypes.data % ALIGNMENT // 8
    return memory[first : first + count].reshape(*shape, ARMS_ABREAST)


def addresses(parts: NamedTuple) -> IntArray:
    """(fields, 3) address and shape of every array of a `Constants` or `Work`, whose memory must stay alive.

    Arrays of groups have one axis more, the arms.
    """
    table = np.zeros((len(parts), 3), np.int64)
    for row, name, values in zip(table, parts._fields, parts, strict=True):
        kind = _kind(type(parts), name)
        shape = values.shape[: kind.ndim]
        assert values.flags.c_contiguous and values.ndim == kind.ndim + (kind.dtype == ARMS), name
        row[0], row[1 : 1 + kind.ndim] = values.ctypes.data, shape
    return table


def _kind(parts: type, name: str) -> types.Array:
    """The type of a field as the kernels for several arms see it."""
    annotation = parts.__annotations__[name]
    dimensions = 2 if annotation is Rows else 1
    if annotation is IntArray:
        return types.Array(types.int64, dimensions, "C", readonly=True)
    if parts is Work or name in PER_ARM:
        return types.Array(ARMS, dimensions, "C")
    return types.Array(types.float64, dimensions, "C", readonly=True)


def _view(context: Any, builder: Any, kind: types.Array, table: Any, row: int) -> Any:
    """The array whose address and shape stand in a row of a table of addresses."""

    def number(column: int) -> Any:
        return builder.load(builder.gep(table, [ir.Constant(ir.IntType(64), 3 * row + column)]))

    array = context.make_array(kind)(context, builder)
    element = context.get_data_type(kind.dtype)
    shape = [number(1 + axis) for axis in range(kind.ndim)]
    size = ir.Constant(ir.IntType(64), context.get_abi_sizeof(element))
    strides = [size] if kind.ndim == 1 else [builder.mul(shape[1], size), size]
    data = builder.inttoptr(number(0), element.as_pointer())
    arrayobj.populate_array(array, data, shape, strides, size, None)
    return array._getvalue()


def _reader(parts: type) -> Any:
    """A function for kernels that makes a `Constants` or `Work` of its table of addresses."""
    kinds = [_kind(parts, name) for name in parts._fields]  # type: ignore[attr-defined]
    whole = types.NamedTuple(kinds, parts)

    @intrinsic
    def read(typing_context, table):
        def generate(context, builder, signature, values):
            data = context.make_array(signature.args[0])(context, builder, values[0]).data
            fields = [_view(context, builder, kind, data, row) for row, kind in enumerate(kinds)]
            return context.make_tuple(builder, whole, fields)

        return whole(table), generate

    return read


constants_at, work_at = _reader(Constants), _reader(Work)


@kernel
def advance(tables, work_table, tableau, drives, clock, rows, found, status):
    """Moves arms by steps of a linearly implicit method under constant drives (b, n + 6).

    `tables` (groups, fields, 3) are the addresses of the constants of each group of ARMS_ABREAST arms. rows
    (b, 2 d + 2), state and ledger, and outputs `found` (b, OUTPUTS) are overwritten where status (b,) is OK and the arm
    does not diverge, which its status then says.
    """
    work, last = work_at(work_table), len(rows) - 1
    state, size, d = work.row, len(work.row), len(work.row) // 2 - 1
    for group in range(len(tables)):
        constants = constants_at(tables[group])
        for k in range(ARMS_ABREAST):
            arm = min(group * ARMS_ABREAST + k, last)  # lanes without an arm repeat the last one
            for j in range(size):
                store_lane_number(state, j, k, rows[arm, j])
            for j in range(len(work.drive)):
                store_lane_number(work.drive, j, k, drives[arm, j])
        for n in range(clock.substeps):
            moment = (clock.time + n * clock.step, clock.step)
            implicit_step(constants, work, tableau, work.drive, moment, state)
            for j in range(size):
                state[j] = work.trial[j]
        observe(constants, work, state[:d], state[d : 2 * d], work.outputs)
        for k in range(min(ARMS_ABREAST, len(rows) - group * ARMS_ABREAST)):
            arm = group * ARMS_ABREAST + k
            for j in range(2 * d):
                if not abs(lane_number(state, j, k)) <= LARGEST_STATE and status[arm] == OK:
                    status[arm] = DIVERGED
            if status[arm] == OK:
                for j in range(size):
                    rows[arm, j] = lane_number(state, j, k)
                for j in range(len(work.outputs)):
                    found[arm, j] = lane_number(work.outputs, j, k)
