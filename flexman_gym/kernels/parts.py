"""Parts: how kernels pass `Constants` and `Work` to each other, as one address.

Numba passes a named tuple as every number of every array in it, 700 of them to each of a hundred functions, which took
a third of the time to compile. Behind the address those numbers lie one after the other; the compiler keeps them in
registers, as no kernel writes over them.
"""

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

from flexman_gym.kernels.fields import Field
from flexman_gym.kernels.layout import Constants, Work

BYTES = ir.IntType(8).as_pointer()


class Parts(types.Type):
    """Numba's name for a `Constants` or `Work` with fields of these kinds; `whole` is the tuple that it stands for."""

    def __init__(self, kinds: list[Field], parts: type) -> None:
        self.whole = types.NamedTuple(kinds, parts)  # type: ignore[attr-defined]
        super().__init__(name=f"Parts({self.whole.name})")


@register_model(Parts)
class PartsModel(models.PrimitiveModel):
    """An address."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, BYTES)

    def from_argument(self, builder: Any, value: Any) -> Any:
        """As it is; a kernel that ends up in no other is told that no array lies over these numbers."""
        if "alwaysinline" not in builder.function.attributes:
            value.add_attribute("noalias")
        return value


@infer_getattr
class PartsFields(AttributeTemplate):
    """The kinds of the fields."""

    key = Parts

    def generic_resolve(self, parts: Any, name: str) -> Any:
        """The kind of one."""
        return parts.whole.types[parts.whole.fields.index(name)]


@lower_getattr_generic(Parts)
def _field(context: Any, builder: Any, kind: Any, address: Any, name: str) -> Any:
    return builder.load(_place(context, builder, kind, address, kind.whole.fields.index(name)))


def _sizes(context: Any, kind: Parts) -> list[int]:
    return [context.get_abi_sizeof(context.get_value_type(each)) for each in kind.whole.types]


def _place(context: Any, builder: Any, kind: Parts, address: Any, row: int) -> Any:
    start = builder.gep(address, [ir.Constant(ir.IntType(64), sum(_sizes(context, kind)[:row]))])
    return builder.bitcast(start, context.get_value_type(kind.whole.types[row]).as_pointer())


def gathered(context: Any, builder: Any, kind: Parts, fields: list[Any]) -> Any:
    """The address of these fields, laid down on the stack of the function that is written."""
    memory = cgutils.alloca_once(builder, ir.ArrayType(ir.IntType(64), sum(_sizes(context, kind)) // 8))
    address = builder.bitcast(memory, BYTES)
    for row, value in enumerate(fields):
        builder.store(value, _place(context, builder, kind, address, row))
    return address


@typeof_impl.register(Constants)
@typeof_impl.register(Work)
def _kind_of(parts: Any, given: Any) -> Parts:
    kinds = [typeof_impl(each, given) for each in parts]
    return Parts([Field(each.dtype, each.ndim, not each.mutable, each.layout) for each in kinds], type(parts))


@unbox(Parts)
def _from_python(kind: Any, parts: Any, c: Any) -> NativeValue:
    native = c.unbox(kind.whole, parts)
    fields = [c.builder.extract_value(native.value, row) for row in range(len(kind.whole.types))]
    return NativeValue(gathered(c.context, c.builder, kind, fields), native.is_error, native.cleanup)
