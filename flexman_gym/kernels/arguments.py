"""Numba types of the arguments `Constants` and `Work`, their aligned arrays and their tables of addresses.

A kernel receives the address of a struct with data pointers and shapes of all arrays. Numba would pass a named tuple
as separate arguments, 700 numbers to each of a hundred functions, which took a third of the compile time. The compiler
keeps the numbers of the struct in registers, as no kernel overwrites them.

Indices of these arrays are unsigned, so kernels cannot count from the end of an array. Numba compares each signed index
with zero to allow that; without the comparison an arm is simulated 1.3 to 1.4 times as fast.
"""

import itertools
import math
import operator
from functools import cache
from typing import Any, NamedTuple, get_args

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.boxing import unbox_array
from numba.core.registry import cpu_target
from numba.core.types import containers
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    intrinsic,
    lower_builtin,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)
from numba.np import arrayobj
from numpy.typing import NDArray

from flexman_gym.kernels.lanes import ARMS, NUMBER, SEQUENCES, TANGENTS, Lanes
from flexman_gym.kernels.layout import ARMS_PER_GROUP, Array, Constants, Flags, IntArray, PerArm, Period, Work


class _ArrayField(types.Array):
    """Numba type of an array of a struct, and of a part of such an array."""

    def __init__(self, dtype: types.Type, ndim: int, readonly: bool = False, layout: Any = "C") -> None:
        name = f"field({dtype}, {ndim}, {layout}, {'readonly' if readonly else 'mutable'})"
        super().__init__(dtype, ndim, layout, readonly=readonly, name=name)

    def copy(self, dtype: Any = None, ndim: Any = None, layout: Any = None, readonly: Any = None) -> Any:
        """Return the type of a part of the array."""
        readonly = not self.mutable if readonly is None else readonly
        return _ArrayField(dtype or self.dtype, self.ndim if ndim is None else ndim, readonly, layout or self.layout)


register_model(_ArrayField)(models.ArrayModel)
unbox(_ArrayField)(unbox_array)


def _unsigned(kinds: Any) -> Any:
    """Return the signature of an array element access with unsigned indices, without the check for negative indices."""
    field, index, *value = kinds.args
    several = isinstance(index, containers.BaseTuple)
    indices = [types.uintp if isinstance(each, types.Integer) else each for each in (index if several else (index,))]
    return kinds.return_type(field, containers.Tuple(indices) if several else indices[0], *value)


@lower_builtin(operator.getitem, _ArrayField, types.Integer)
def _read(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return arrayobj.getitem_arraynd_intp(context, builder, _unsigned(kinds), values)


@lower_builtin(operator.getitem, _ArrayField, containers.BaseTuple)
def _read_by_axes(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return arrayobj.getitem_array_tuple(context, builder, _unsigned(kinds), values)


@lower_builtin(operator.setitem, _ArrayField, types.Any, types.Any)
def _write(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return arrayobj.setitem_array(context, builder, _unsigned(kinds), values)


@intrinsic
def field(typing_context, array):
    """Return a contiguous, writable array of numbers with the type of an array of a struct, others as they are.

    Kernels for Python convert their arrays with it: inner kernels are then compiled for one type of array.
    """
    kind = array
    if type(array) is types.Array and array.layout == "C" and array.mutable and array.dtype == NUMBER:
        kind = _ArrayField(array.dtype, array.ndim)
    return kind(array), lambda context, builder, kinds, values: values[0]


BYTE_POINTER = ir.IntType(8).as_pointer()


class _StructPointer(types.Type):
    """Numba type of a `Constants` or `Work` with fields of given types; `whole` is the type of the named tuple."""

    def __init__(self, kinds: list[types.Array], parts: type) -> None:
        self.whole = types.NamedTuple(kinds, parts)  # type: ignore[attr-defined]
        super().__init__(name=f"Parts({self.whole.name})")


@register_model(_StructPointer)
class _StructPointerModel(models.PrimitiveModel):
    """Data model: an address."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, BYTE_POINTER)

    def from_argument(self, builder: Any, value: Any) -> Any:
        """Return the value; in a kernel that is not inlined, declare that no array overlaps the struct."""
        if "alwaysinline" not in builder.function.attributes:
            value.add_attribute("noalias")
        return value


@infer_getattr
class _StructFields(AttributeTemplate):
    """Type inference of the fields of a struct."""

    key = _StructPointer

    def generic_resolve(self, parts: Any, name: str) -> Any:
        """Return the type of a field."""
        return parts.whole.types[parts.whole.fields.index(name)]


@lower_getattr_generic(_StructPointer)
def _field(context: Any, builder: Any, kind: Any, address: Any, name: str) -> Any:
    return builder.load(_field_address(context, builder, kind, address, kind.whole.fields.index(name)))


@cache
def _starts(kind: _StructPointer) -> list[int]:
    """Return where each field starts and the last one ends, in bytes.

    LLVM parses a module for each size. The contexts of the compiled functions differ, but not the sizes in them.
    """
    context = cpu_target.target_context
    sizes = [context.get_abi_sizeof(context.get_value_type(each)) for each in kind.whole.types]
    return [0, *itertools.accumulate(sizes)]


def _field_address(context: Any, builder: Any, kind: _StructPointer, address: Any, row: int) -> Any:
    start = builder.gep(address, [ir.Constant(ir.IntType(64), _starts(kind)[row])])
    return builder.bitcast(start, context.get_value_type(kind.whole.types[row]).as_pointer())


def _store_struct(context: Any, builder: Any, kind: _StructPointer, fields: list[Any]) -> Any:
    """Store fields in a struct on the stack of the compiled function, and return its address."""
    memory = cgutils.alloca_once(builder, ir.ArrayType(ir.IntType(64), _starts(kind)[-1] // 8))
    address = builder.bitcast(memory, BYTE_POINTER)
    for row, value in enumerate(fields):
        builder.store(value, _field_address(context, builder, kind, address, row))
    return address


@typeof_impl.register(Constants)
@typeof_impl.register(Work)
def _kind_of(parts: Any, given: Any) -> _StructPointer:
    kinds = [typeof_impl(each, given) for each in parts]
    readonly = [not each.mutable or isinstance(each.dtype, types.Integer) for each in kinds]  # as in `_kind`
    pairs = zip(kinds, readonly, strict=True)
    return _StructPointer(
        [_ArrayField(each.dtype, each.ndim, fixed, each.layout) for each, fixed in pairs], type(parts)
    )


@unbox(_StructPointer)
def _from_python(kind: Any, parts: Any, c: Any) -> NativeValue:
    native = c.unbox(kind.whole, parts)
    fields = [c.builder.extract_value(native.value, row) for row in range(len(kind.whole.types))]
    return NativeValue(_store_struct(c.context, c.builder, kind, fields), native.is_error, native.cleanup)


# Constants that may differ between the arms of a batch.
PER_ARM = frozenset(name for name, kind in Constants.__annotations__.items() if kind is PerArm)
ALL = frozenset(name for name, kind in Constants.__annotations__.items() if kind is not IntArray)  # all numbers

ALIGNMENT = 64  # bytes; size of a group of ARMS_PER_GROUP numbers


def aligned_zeros(shape: tuple[int, ...], lanes: int = ARMS_PER_GROUP) -> Array:
    """Return zeros of a shape (..., lanes), aligned for vector registers."""
    count = math.prod(shape) * lanes
    buffer = np.zeros(count + ALIGNMENT // 8)
    first = -_address(buffer) % ALIGNMENT // 8
    return buffer[first : first + count].reshape(*shape, lanes)


def tangent_constants(constants: Constants, own: frozenset[str] = PER_ARM) -> Constants:
    """Return the constants of a group `lanes.TANGENTS` with derivatives of zero; those named `own` have some."""
    groups: dict[str, Any] = {name: aligned_zeros(getattr(constants, name).shape) for name in own}
    for name, values in groups.items():
        values[..., 0] = getattr(constants, name)
    return constants._replace(**groups)


def address_table(arrays: NamedTuple, element: types.Type, own: frozenset[str] = PER_ARM) -> IntArray:
    """Return the addresses and shapes of all arrays of a `Constants`, `Work` or `Period`.

    Args:
        arrays: the named tuple; its arrays must stay alive.
        element: type of the elements: NUMBER, or ARMS, SEQUENCES or TANGENTS, whose arrays have one more axis for the
            lanes.
        own: names of the constants that differ between lanes.

    Returns:
        (fields, 3) address, and lengths of the first and second axis; 0 for an array with one axis.

    Raises:
        TypeError: for an array of another layout than the annotation of its field.
    """
    rows = []
    for name, values in zip(arrays._fields, arrays, strict=True):
        kind, shape = _kind(type(arrays), name, element, own), values.shape
        if not values.flags.c_contiguous or len(shape) != kind.ndim + isinstance(kind.dtype, Lanes):
            raise TypeError(f"{name} is not a contiguous array with {kind.ndim} axes")
        if values.dtype != _scalar(type(arrays), name):
            raise TypeError(f"{name} is an array of {values.dtype}")
        columns = shape[1] if kind.ndim == 2 else 0
        if columns != (_columns(type(arrays), name) or columns):
            raise TypeError(f"{name} has {columns} columns")
        rows.append((_address(values), shape[0], columns))
    return np.array(rows, np.int64)


def _address(values: Array) -> int:
    return int(values.__array_interface__["data"][0])


@cache
def _kind(parts: type, name: str, element: types.Type, own: frozenset[str]) -> types.Array:
    """Return the type of a field in the kernels; constants shared by all lanes are read-only, see `lanes`."""
    annotation = parts.__annotations__[name]
    dimensions = 1 if annotation is PerArm or not hasattr(annotation, "__metadata__") else 2
    if parts is Period:  # its arrays are arguments of kernels that Python calls too
        return types.Array(numba.from_dtype(np.dtype(_scalar(parts, name))), dimensions, "C")
    if annotation is IntArray:
        return _ArrayField(types.int64, dimensions, readonly=True)
    if parts is Work or element == NUMBER or (element in (ARMS, TANGENTS) and name in own):
        return _ArrayField(element, dimensions)
    return _ArrayField(NUMBER, dimensions, readonly=True)


SCALARS: dict[Any, Any] = {Array: np.float64, IntArray: np.int64, Flags: np.bool_, NDArray[np.float32]: np.float32}


def _scalar(parts: type, name: str) -> Any:
    """Return the scalar type of a field."""
    annotation = parts.__annotations__[name]
    return SCALARS[get_args(annotation)[0] if hasattr(annotation, "__metadata__") else annotation]


@cache
def _columns(parts: type, name: str) -> int:
    """Return the number of columns of a field, 0 for one axis or a number that depends on the model."""
    annotation = parts.__annotations__[name]
    return 0 if annotation is PerArm else getattr(annotation, "__metadata__", (0,))[0]


def _view(context: Any, builder: Any, kind: types.Array, address: tuple[Any, int], columns: int) -> Any:
    """Return the array given by a row of an address table; `address` is the table and the index of the row."""
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


class SingleTables(NamedTuple):
    """Addresses of single arms; the class of address tables selects the types of the arrays in the kernels.

    In place of this class the kernels receive a plain tuple, whose type Numba finds faster by a microsecond.

    Attributes:
        constants: (groups, fields, 3) address tables of the constants of each group, here of each arm.
        work: (fields, 3) address table of the scratch arrays.
    """

    constants: IntArray
    work: IntArray


class ArmTables(SingleTables):
    """Addresses of groups of ARMS_PER_GROUP arms."""


class SequenceTables(SingleTables):
    """Addresses of a group of sequences of an extrapolated step."""


class TangentTables(SingleTables):
    """Addresses of groups of an arm and its derivatives, with derivatives of the constants PER_ARM."""


class AllTangentTables(SingleTables):
    """Addresses of groups of an arm and its derivatives, with derivatives of all constants."""


# Type of the elements of scratch arrays, and names of the constants that differ between lanes.
ELEMENTS: dict[type, tuple[types.Type, frozenset[str]]] = {
    SingleTables: (NUMBER, PER_ARM), ArmTables: (ARMS, PER_ARM), SequenceTables: (SEQUENCES, PER_ARM),
    TangentTables: (TANGENTS, PER_ARM), AllTangentTables: (TANGENTS, ALL),
}  # fmt: skip


def make_tables(kind: type[SingleTables], constants: IntArray, work: IntArray) -> tuple[IntArray, IntArray]:
    """Return address tables as an argument of the kernels."""
    return (constants, work) if kind is SingleTables else kind(constants, work)


def address_tables(kind: type[SingleTables], constants: Constants, work: Work) -> tuple[IntArray, IntArray]:
    """Return the address tables of the constants of one group and of scratch arrays, which must stay alive."""
    element, own = ELEMENTS[kind]
    return make_tables(kind, address_table(constants, element, own)[None], address_table(work, element))


@cache
def _struct(parts: type, element: types.Type, own: frozenset[str]) -> _StructPointer:
    """Return the type of a `Constants`, `Work` or `Period` of an address table."""
    return _StructPointer([_kind(parts, name, element, own) for name in parts._fields], parts)  # type: ignore[attr-defined]


def _read_table(context: Any, builder: Any, whole: _StructPointer, table: Any) -> Any:
    """Return the address of a struct with the arrays of an address table."""
    parts = whole.whole.instance_class
    places = enumerate(zip(whole.whole.types, parts._fields, strict=True))
    fields = [_view(context, builder, kind, (table, row), _columns(parts, name)) for row, (kind, name) in places]
    return _store_struct(context, builder, whole, fields)


def _reader(parts: type, column: int) -> Any:
    """Return a function for kernels that reads a group from a column of address tables, as a `Constants` or `Work`.

    In place of the tables it accepts a pair (constants, work) of a single arm.
    """

    @intrinsic
    def read(typing_context, tables, group):
        given = tables.types[column]
        if isinstance(given, _StructPointer):
            return given(tables, types.intp), lambda _, builder, kinds, values: builder.extract_value(values[0], column)
        whole = _struct(parts, *ELEMENTS[getattr(tables, "instance_class", SingleTables)])

        def generate(context, builder, signature, values):
            array = builder.extract_value(values[0], column)
            data = context.make_array(signature.args[0].types[column])(context, builder, array).data
            first = builder.mul(values[1], ir.Constant(ir.IntType(64), 3 * len(parts._fields)))
            return _read_table(context, builder, whole, builder.gep(data, [first]))

        return whole(tables, types.intp), generate

    return read


constants_of, work_of = _reader(Constants, 0), _reader(Work, 1)


@intrinsic
def period_of(typing_context, table):
    """Return the `Period` of an address table (fields, 3)."""
    whole = _struct(Period, NUMBER, PER_ARM)

    def generate(context, builder, signature, values):
        data = context.make_array(signature.args[0])(context, builder, values[0]).data
        return _read_table(context, builder, whole, data)

    return whole(table), generate
