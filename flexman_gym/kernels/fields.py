"""Fields: the arrays of `Constants` and `Work` as kernels see them, whose indices are never negative.

For Numba an index may count from the end, so that it compares each one with zero and adds the length to those below.
Kernels count from the start alone: without that arms move 1.3 to 1.4 times as fast.
"""

import operator
from typing import Any

from numba.core import types
from numba.core.boxing import unbox_array
from numba.core.types import containers
from numba.extending import lower_builtin, models, register_model, unbox
from numba.np import arrayobj


class Field(types.Array):
    """Numba's name for such an array; parts of it are fields too."""

    def __init__(self, dtype: types.Type, ndim: int, readonly: bool = False, layout: Any = "C") -> None:
        name = f"field({dtype}, {ndim}, {layout}, {'readonly' if readonly else 'mutable'})"
        super().__init__(dtype, ndim, layout, readonly=readonly, name=name)

    def copy(self, dtype: Any = None, ndim: Any = None, layout: Any = None, readonly: Any = None) -> Any:
        """The type of a part of the array."""
        readonly = not self.mutable if readonly is None else readonly
        return Field(dtype or self.dtype, self.ndim if ndim is None else ndim, readonly, layout or self.layout)


register_model(Field)(models.ArrayModel)
unbox(Field)(unbox_array)


def _unsigned(kinds: Any) -> Any:
    """The types of an access, its indices without a sign: those Numba takes as they are."""
    field, index, *value = kinds.args
    several = isinstance(index, containers.BaseTuple)
    indices = [types.uintp if isinstance(each, types.Integer) else each for each in (index if several else (index,))]
    return kinds.return_type(field, containers.Tuple(indices) if several else indices[0], *value)


@lower_builtin(operator.getitem, Field, types.Integer)
def _read(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return arrayobj.getitem_arraynd_intp(context, builder, _unsigned(kinds), values)


@lower_builtin(operator.getitem, Field, containers.BaseTuple)
def _read_by_axes(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return arrayobj.getitem_array_tuple(context, builder, _unsigned(kinds), values)


@lower_builtin(operator.setitem, Field, types.Any, types.Any)
def _write(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return arrayobj.setitem_array(context, builder, _unsigned(kinds), values)
