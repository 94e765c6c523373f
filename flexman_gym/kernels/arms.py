"""Arms: several of one model that move side by side, each in a lane of the processor's vector registers.

One set of kernels moves one arm or ARMS_ABREAST of them: here they are compiled for work space whose elements are
groups of numbers, one for each arm. Lanes do not mix, so that an arm moves in the same way, to the last bit, whatever
its neighbours are. Constants that arms may differ in (`PER_ARM`) are such groups too, the others are shared. A call
passes addresses instead of arrays, which takes microseconds less.
"""

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numba.np import arrayobj

from flexman_gym.kernels.arguments import ArrayField, StructPointer, store_struct
from flexman_gym.kernels.compile import inner, kernel, released
from flexman_gym.kernels.implicit import fixed_newton_step
from flexman_gym.kernels.lanes import ARMS, NUMBER, SEQUENCES, Lanes, load_lane, store_lane
from flexman_gym.kernels.layout import (
    ARMS_ABREAST,
    DIVERGED,
    LARGEST_STATE,
    OK,
    Array,
    Constants,
    IntArray,
    Own,
    Work,
)
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import observe
from flexman_gym.kernels.runge_kutta import linearly_implicit_step, out_of_bounds, run_w_method, step_time

PER_ARM = frozenset(name for name, kind in Constants.__annotations__.items() if kind is Own)
ALIGNMENT = 64  # bytes; of a group of eight numbers


def arms_array(shape: tuple[int, ...], lanes: int = ARMS_ABREAST) -> Array:
    """Zeros (..., lanes), aligned for vector registers."""
    count = math.prod(shape) * lanes
    memory = np.zeros(count + ALIGNMENT // 8)
    first = -_address(memory) % ALIGNMENT // 8
    return memory[first : first + count].reshape(*shape, lanes)


def sequences_array(shape: tuple[int, ...]) -> Array:
    """The same for sequences of one arm."""
    return arms_array(shape, SEQUENCES.width)


def address_table(parts: NamedTuple, element: types.Type) -> IntArray:
    """(fields, 3) address and shape of every array of a `Constants` or `Work`, whose memory must stay alive.

    Elements are numbers (NUMBER), or `ARMS` or `SEQUENCES`, whose arrays have one axis more.
    """
    rows = []
    for name, values in zip(parts._fields, parts, strict=True):
        kind, shape = _kind(type(parts), name, element), values.shape
        if not values.flags.c_contiguous or len(shape) != kind.ndim + isinstance(kind.dtype, Lanes):
            raise TypeError(f"{name} is no contiguous array of {kind.ndim} axes")
        columns = shape[1] if kind.ndim == 2 else 0
        if columns != (_columns(type(parts), name) or columns):
            raise TypeError(f"{name} has {columns} columns")
        rows.append((_address(values), shape[0], columns))
    return np.array(rows, np.int64)


def _address(values: Array) -> int:
    return int(values.__array_interface__["data"][0])


@cache
def _kind(parts: type, name: str, element: types.Type) -> ArrayField:
    """The type of a field as the kernels see it; read-only are the constants that several arms share, see `lanes`."""
    annotation = parts.__annotations__[name]
    dimensions = 1 if annotation is Own or not hasattr(annotation, "__metadata__") else 2
    if annotation is IntArray:
        return ArrayField(types.int64, dimensions, readonly=True)
    if parts is Work or element == NUMBER or (element == ARMS and name in PER_ARM):
        return ArrayField(element, dimensions)
    return ArrayField(NUMBER, dimensions, readonly=True)


@cache
def _columns(parts: type, name: str) -> int:
    """The number of columns of a field that has two axes, 0 where it depends on the model."""
    annotation = parts.__annotations__[name]
    return 0 if annotation is Own else getattr(annotation, "__metadata__", (0,))[0]


def _view(context: Any, builder: Any, kind: ArrayField, address: tuple[Any, int], columns: int) -> Any:
    """The array whose address and shape stand in a row of a table of addresses."""
    table, row = address

    def number(column: int) -> Any:
        return builder.load(builder.gep(table, [ir.Constant(ir.IntType(64), 3 * row + column)]))

    array = context.make_array(kind)(context, builder)
    element = context.get_data_type(kind.dtype)
    shape = [number(1 + axis) for axis in range(kind.ndim)]
    if columns:
        shape[1] = ir.Constant(ir.IntType(64), columns)
    size = ir.Constant(ir.IntType(64), context.get_abi_sizeof(element))
    strides = [size] if kind.ndim == 1 else [builder.mul(shape[1], size), size]
    data = builder.inttoptr(number(0), element.as_pointer())
    arrayobj.populate_array(array, data, shape, strides, size, None)
    return array._getvalue()


def _reader(parts: type, element: types.Type) -> Any:
    """A function for kernels that makes a `Constants` or `Work` of its table of addresses."""
    kinds = [_kind(parts, name, element) for name in parts._fields]  # type: ignore[attr-defined]
    columns = [_columns(parts, name) for name in parts._fields]  # type: ignore[attr-defined]
    whole = StructPointer(kinds, parts)

    @intrinsic
    def read(typing_context, table):
        def generate(context, builder, signature, values):
            data = context.make_array(signature.args[0])(context, builder, values[0]).data
            places = zip(kinds, columns, strict=True)
            fields = [_view(context, builder, kind, (data, row), width) for row, (kind, width) in enumerate(places)]
            return store_struct(context, builder, whole, fields)

        return whole(table), generate

    return read


constants_of_arms, work_of_arms = _reader(Constants, ARMS), _reader(Work, ARMS)
constants_of_one, work_of_one = _reader(Constants, NUMBER), _reader(Work, NUMBER)
constants_of_sequences, work_of_sequences = _reader(Constants, SEQUENCES), _reader(Work, SEQUENCES)


@inner
def advance_steps(constants, work, tableau, sweeps, steps, state):
    """Moves state and ledger, an array of work space, under work.drive by steps, their length (s) and number.

    By a linearly implicit method, or, without a tableau (None), by sweeps, see `fixed_newton_step`. Then fills
    work.outputs.
    """
    d, (step, count) = len(state) // 2 - 1, steps
    for n in range(count):
        moment = n * step, step
        if tableau is None:
            fixed_newton_step(constants, work, sweeps, None, moment, state)
        else:
            linearly_implicit_step(constants, work, tableau, None, moment, state)
        copy(work.trial, state)
    observe(constants, work, state[:d], state[d : 2 * d], work.outputs)


@released
def advance_arms(tables, work_table, method, drives, steps, rows, out, status, trail):
    """Moves arms by a method, a tableau or None with sweeps as in `advance_steps`, through periods of constant drives.

    `tables` (groups, fields, 3) are the addresses of the constants of each group of ARMS_ABREAST arms, drives are (b,
    T, n + 6). Overwrites rows (b, 2 d + 2) and outputs `out` (b, OUTPUTS) of the arms whose status (b,) is OK until one
    diverges; it is DIVERGED then. The trail has both after each good period, (b, T, ...), or no period at all.
    """
    work = work_of_arms(work_table)
    state = work.row
    for group in range(len(tables)):
        first, end = group * ARMS_ABREAST, min((group + 1) * ARMS_ABREAST, len(rows))
        if _any_moving(status, first, end):
            fill_lanes(rows, first, state)
            for t in range(drives.shape[1]):
                fill_lanes(drives[:, t], first, work.drive)
                advance_steps(constants_of_arms(tables[group]), work, method[0], method[1], steps, state)
                for arm in range(first, end):
                    if status[arm] == OK and not _lane_in_bounds(state, arm - first):
                        status[arm] = DIVERGED
                    if status[arm] == OK:
                        read_lane(state, arm - first, rows[arm])
                        read_lane(work.outputs, arm - first, out[arm])
                        _record_period(trail, arm, t, rows, out)


@released
def advance_one(table, work_table, method, drives, steps, rows, out, status, trail):
    """The same for a single arm."""
    work = work_of_one(work_table)
    copy(rows[0], work.row)
    for t in range(drives.shape[1]):
        if status[0] == OK:
            copy(drives[0, t], work.drive)
            advance_steps(constants_of_one(table), work, method[0], method[1], steps, work.row)
            status[0] = DIVERGED if out_of_bounds(work.row) else OK
            if status[0] == OK:
                copy(work.row, rows[0])
                copy(work.outputs, out[0])
                _record_period(trail, 0, t, rows, out)


@inner
def _record_period(trail, arm, t, rows, out):
    """Puts row and outputs of an arm after period t into a trail that has periods."""
    if trail[0].shape[1] > 0:
        copy(rows[arm], trail[0][arm, t])
        copy(out[arm], trail[1][arm, t])


@released
def run_arms(tables, work_table, tableau, sweeps, drives, clock, rows, out, counts):
    """Runs of arms by fixed steps as in `advance_steps`, each under the table of its own drive (b, 7, n + 6).

    Overwrites rows (b, r + 1, 2 d + 2) behind the first one, from which an arm starts, and outputs `out` (b, r + 1,
    OUTPUTS). counts (b, 2) = how many rows are valid behind the first, and the steps that were taken.
    """
    work = work_of_arms(work_table)
    for group in range(len(tables)):
        constants, first = constants_of_arms(tables[group]), group * ARMS_ABREAST
        end = min(first + ARMS_ABREAST, len(rows))
        _load_arms(work, drives, rows, first)
        for arm in range(first, end):
            counts[arm, 0], counts[arm, 1] = -1, 0
        for r in range(rows.shape[1]):
            for n in range(clock.substeps if r > 0 else 0):
                moment = step_time(clock, r - 1, n), clock.step
                if tableau is None:
                    fixed_newton_step(constants, work, sweeps, work.table, moment, work.row)
                else:
                    linearly_implicit_step(constants, work, tableau, work.table, moment, work.row)
                for arm in range(first, end):
                    if counts[arm, 0] < 0:
                        counts[arm, 1] += 1
                        if not _lane_in_bounds(work.trial, arm - first):
                            counts[arm, 0] = r - 1
                copy(work.trial, work.row)
            d = len(work.row) // 2 - 1
            observe(constants, work, work.row[:d], work.row[d : 2 * d], work.outputs)
            for arm in range(first, end):
                if counts[arm, 0] < 0:
                    read_lane(work.row, arm - first, rows[arm, r])
                    read_lane(work.outputs, arm - first, out[arm, r])
        for arm in range(first, end):
            if counts[arm, 0] < 0:
                counts[arm, 0] = rows.shape[1] - 1


@inner
def _load_arms(work, drives, rows, first):
    """work.row and work.table = the first rows and the drives of the arms from `first` on."""
    for k in range(ARMS_ABREAST):
        arm = min(first + k, len(rows) - 1)  # lanes without an arm repeat the last one
        for j in range(len(work.row)):
            store_lane(work.row, j, k, rows[arm, 0, j])
        for i in range(len(work.table)):
            for j in range(len(work.drive)):
                store_lane(work.table[i], j, k, drives[arm, i, j])


@kernel
def run_sequences(constants, work, lanes, tableau, table, clock, state, rows, outputs):
    """A run as in `linearly_implicit`, of one arm by an extrapolated method, with several sequences in the lanes.

    `lanes` are the addresses of the same constants, those of work space of sequences, and the rounds of
    `sequences_step`. The bits are those of one sequence after the other.
    """
    abreast = constants_of_sequences(lanes[0]), work_of_sequences(lanes[1]), lanes[2]
    return run_w_method(constants, work, abreast, tableau, table, clock, state, rows, outputs)


@inner
def fill_lanes(values, first, flat):
    """The numbers (b, j) of the group of arms from `first` on into the lanes of flat (j,)."""
    for k in range(ARMS_ABREAST):
        arm = min(first + k, len(values) - 1)  # lanes without an arm repeat the last one
        for j in range(len(flat)):
            store_lane(flat, j, k, values[arm, j])


@inner
def read_lane(flat, k, out):
    """out = lane k of the first numbers of a flat array of arms abreast."""
    for j in range(len(out)):
        out[j] = load_lane(flat, j, k)


@inner
def _any_moving(status, first, end):
    """Whether an arm from `first` to `end` is to be moved."""
    for arm in range(first, end):
        if status[arm] == OK:
            return True
    return False


@inner
def _lane_in_bounds(state, k):
    """Whether the state in lane k is finite and within LARGEST_STATE; the ledger is not looked at."""
    for j in range(len(state) - 2):
        if not abs(load_lane(state, j, k)) <= LARGEST_STATE:
            return False
    return True
