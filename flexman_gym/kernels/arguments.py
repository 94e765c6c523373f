"""Numba types of the kernels' arguments `Constants` and `Work`: one address of a struct of arrays.

Numba passes a named tuple as every number of every array in it, 700 of them to each of a hundred functions, which took
a third of the time to compile. Behind the address those numbers lie one after the other; the compiler keeps them in
registers, as no kernel writes over them.

Indices of these arrays are unsigned: kernels count from the start alone. For Numba an index may count from the end, so
that it compares each one with zero; without that arms move 1.3 to 1.4 times as fast.
"""

import operator
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.boxing import unbox_array
from numba.core.types import containers
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_builtin,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)
from numba.np import arrayobj

from flexman_gym.kernels.layout import Constants, Work


class ArrayField(types.Array):
    """Numba's name for such an array; parts of it are fields too."""

    def __init__(self, dtype: types.Type, ndim: int, readonly: bool = False, layout: Any = "C") -> None:
        name = f"field({dtype}, {ndim}, {layout}, {'readonly' if readonly else 'mutable'})"
        super().__init__(dtype, ndim, layout, readonly=readonly, name=name)

    def copy(self, dtype: Any = None, ndim: Any = None, layout: Any = None, readonly: Any = None) -> Any:
        """The type of a part of the array."""
        readonly = not self.mutable if readonly is None else readonly
        return ArrayField(dtype or self.dtype, self.ndim if ndim is None else ndim, readonly, layout or self.layout)


register_model(ArrayField)(models.ArrayModel)
unbox(ArrayField)(unbox_array)


def _unsigned(kinds: Any) -> Any:
    """The types of an access, its indices without a sign: those Numba takes as they are."""
    field, index, *value = kinds.args
    several = isinstance(index, containers.BaseTuple)
    indices = [types.uintp if isinstance(each, types.Integer) else each for each in (index if several else (index,))]
    return kinds.return_type(field, containers.Tuple(indices) if several else indices[0], *value)


@lower_builtin(operator.getitem, ArrayField, types.Integer)
def _read(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return arrayobj.getitem_arraynd_intp(context, builder, _unsigned(kinds), values)


@lower_builtin(operator.getitem, ArrayField, containers.BaseTuple)
def _read_by_axes(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return arrayobj.getitem_array_tuple(context, builder, _unsigned(kinds), values)


@lower_builtin(operator.setitem, ArrayField, types.Any, types.Any)
def _write(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return arrayobj.setitem_array(context, builder, _unsigned(kinds), values)


BYTES = ir.IntType(8).as_pointer()


class StructPointer(types.Type):
    """Numba's name for a `Constants` or `Work` with fields of these kinds; `whole` is the tuple that it stands for."""

    def __init__(self, kinds: list[ArrayField], parts: type) -> None:
        self.whole = types.NamedTuple(kinds, parts)  # type: ignore[attr-defined]
        super().__init__(name=f"Parts({self.whole.name})")


@register_model(StructPointer)
class _StructPointerModel(models.PrimitiveModel):
    """An address."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, BYTES)

    def from_argument(self, builder: Any, value: Any) -> Any:
        """As it is; a kernel that ends up in no other is told that no array lies over these numbers."""
        if "alwaysinline" not in builder.function.attributes:
            value.add_attribute("noalias")
        return value


@infer_getattr
class _StructFields(AttributeTemplate):
    """The kinds of the fields."""

    key = StructPointer

    def generic_resolve(self, parts: Any, name: str) -> Any:
        """The kind of one."""
        return parts.whole.types[parts.whole.fields.index(name)]


@lower_getattr_generic(StructPointer)
def _field(context: Any, builder: Any, kind: Any, address: Any, name: str) -> Any:
    return builder.load(_place(context, builder, kind, address, kind.whole.fields.index(name)))


def _sizes(context: Any, kind: StructPointer) -> list[int]:
    return [context.get_abi_sizeof(context.get_value_type(each)) for each in kind.whole.types]


def _place(context: Any, builder: Any, kind: StructPointer, address: Any, row: int) -> Any:
    start = builder.gep(address, [ir.Constant(ir.IntType(64), sum(_sizes(context, kind)[:row]))])
    return builder.bitcast(start, context.get_value_type(kind.whole.types[row]).as_pointer())


def store_struct(context: Any, builder: Any, kind: StructPointer, fields: list[Any]) -> Any:
    """The address of these fields, laid down on the stack of the function that is written."""
    memory = cgutils.alloca_once(builder, ir.ArrayType(ir.IntType(64), sum(_sizes(context, kind)) // 8))
    address = builder.bitcast(memory, BYTES)
    for row, value in enumerate(fields):
        builder.store(value, _place(context, builder, kind, address, row))
    return address


@typeof_impl.register(Constants)
@typeof_impl.register(Work)
def _kind_of(parts: Any, given: Any) -> StructPointer:
    kinds = [typeof_impl(each, given) for each in parts]
    return StructPointer(
        [ArrayField(each.dtype, each.ndim, not each.mutable, each.layout) for each in kinds], type(parts)
    )


@unbox(StructPointer)
def _from_python(kind: Any, parts: Any, c: Any) -> NativeValue:
    native = c.unbox(kind.whole, parts)
    fields = [c.builder.extract_value(native.value, row) for row in range(len(kind.whole.types))]
    return NativeValue(store_struct(c.context, c.builder, kind, fields), native.is_error, native.cleanup)
