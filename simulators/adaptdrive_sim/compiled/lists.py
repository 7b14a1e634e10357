"""Lists in compiled code: of numbers, and of objects of one layout, one behind the other.

A list is the address of its first entry and the number of entries, which never changes. Nobody
counts its users: the words of an object, or the `room`, hold the entries.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel.models import PrimitiveModel, StructModel
from numba.core.imputils import RefType, iternext_impl, lower_builtin
from numba.core.types.common import SimpleIteratorType
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import box, register_model
from numba.np.arrayobj import make_array, populate_array

WORD = 8


class ListType(types.IterableType):
    """Type of the lists of entries of one type."""

    def __init__(self, entry: Any) -> None:
        self.dtype = entry
        super().__init__(name=f"list_of_{entry.name}")

    @property
    def iterator_type(self) -> Any:
        """Type of an iterator over the list."""
        return EachType(self)

    @property
    def words(self) -> int | None:
        """Words of an object in the list; None for a number."""
        layout = getattr(self.dtype, "layout", None)
        return None if layout is None else layout.words


class EachType(SimpleIteratorType):
    """Type of the iterators over the lists of one type."""

    def __init__(self, container: ListType) -> None:
        self.container = container
        super().__init__(f"each_of_{container.name}", container.dtype)


@register_model(ListType)
class _List(StructModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, [("first", types.voidptr), ("count", types.intp)])


@register_model(EachType)
class _Each(StructModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        index = types.EphemeralPointer(types.intp)
        super().__init__(dmm, fe_type, [("list", fe_type.container), ("index", index)])


class Pointer(PrimitiveModel):
    """An address in memory."""

    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, ir.IntType(8).as_pointer())


def make_list(context: Any, builder: Any, kind: ListType, first: Any, count: Any) -> Any:
    """Return the list of so many entries that lie at an address."""
    made = context.make_helper(builder, kind)
    made.first = builder.bitcast(first, ir.IntType(8).as_pointer())
    made.count = count
    return made._getvalue()  # noqa: SLF001


@infer_global(len)
class _Counting(AbstractTemplate):
    def generic(self, args: Any, _: Any) -> Any:
        return signature(types.intp, *args) if isinstance(args[0], ListType) else None


@infer_global(operator.getitem)
class _Reading(AbstractTemplate):
    def generic(self, args: Any, _: Any) -> Any:
        values, index = args
        if isinstance(values, ListType) and isinstance(index, types.Integer):
            return signature(values.dtype, *args)
        return None


@infer_global(operator.setitem)
class _Writing(AbstractTemplate):
    def generic(self, args: Any, _: Any) -> Any:
        values, index, value = args
        number = isinstance(value, types.Number | types.Boolean)
        if isinstance(values, ListType) and isinstance(index, types.Integer) and number:
            return signature(types.none, values, index, values.dtype)
        return None


@lower_builtin(len, ListType)
def _count(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    return context.make_helper(builder, signature.args[0], value=args[0]).count


@lower_builtin(operator.getitem, ListType, types.Integer)
def _read(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    values, index = signature.args
    return _load(builder, values, _place(context, builder, values, args[0], index, args[1]))


@lower_builtin(operator.setitem, ListType, types.Integer, types.Any)
def _write(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    values, index, _ = signature.args
    builder.store(args[2], _place(context, builder, values, args[0], index, args[1]))
    return context.get_dummy_value()


def _place(context: Any, builder: Any, kind: Any, values: Any, index_type: Any, index: Any) -> Any:
    """Return the address of an entry; a negative index counts from the end."""
    values = context.make_helper(builder, kind, value=values)
    index = context.cast(builder, index, index_type, types.intp)
    if index_type.signed:
        zero = context.get_constant(types.intp, 0)
        from_end = builder.icmp_signed("<", index, zero)
        index = builder.select(from_end, builder.add(index, values.count), index)
    if kind.words is not None:
        beyond = builder.icmp_unsigned(">=", index, values.count)
        with builder.if_then(beyond, likely=False):
            words = ("list index out of range",)
            context.call_conv.return_user_exc(builder, IndexError, words)
    return _address(context, builder, kind, values.first, index)


def _address(context: Any, builder: Any, kind: ListType, first: Any, index: Any) -> Any:
    if kind.words is None:
        first = builder.bitcast(first, context.get_value_type(kind.dtype).as_pointer())
        return builder.gep(first, [index], inbounds=True)
    size = context.get_constant(types.intp, kind.words * WORD)
    return builder.gep(first, [builder.mul(index, size)], inbounds=True)


def _load(builder: Any, kind: ListType, place: Any) -> Any:
    return builder.load(place) if kind.words is None else place


@lower_builtin("getiter", ListType)
def _begin(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    each = context.make_helper(builder, signature.return_type)
    each.list = args[0]
    each.index = cgutils.alloca_once_value(builder, context.get_constant(types.intp, 0))
    return each._getvalue()  # noqa: SLF001


@lower_builtin("iternext", EachType)
@iternext_impl(RefType.BORROWED)
def _next(context: Any, builder: Any, signature: Any, args: Any, result: Any) -> None:
    kind = signature.args[0].container
    each = context.make_helper(builder, signature.args[0], value=args[0])
    values, index = context.make_helper(builder, kind, value=each.list), builder.load(each.index)
    more = builder.icmp_signed("<", index, values.count)
    result.set_valid(more)
    with builder.if_then(more):
        result.yield_(_load(builder, kind, _address(context, builder, kind, values.first, index)))
        builder.store(builder.add(index, context.get_constant(types.intp, 1)), each.index)


@box(ListType)
def _box(kind: ListType, value: Any, c: Any) -> Any:
    """Give a list of numbers to the interpreter: an array with a copy of them."""
    values = c.context.make_helper(c.builder, kind, value=value)
    array = types.Array(kind.dtype, 1, "C")
    seen, word = make_array(array)(c.context, c.builder), c.context.get_constant(types.intp, WORD)
    first = c.builder.bitcast(values.first, c.context.get_value_type(kind.dtype).as_pointer())
    populate_array(seen, first, [values.count], [word], word, meminfo=None, parent=None)
    view = c.box(array, seen._getvalue())  # noqa: SLF001
    copy = c.pyapi.call_method(view, "copy")
    c.pyapi.decref(view)
    return copy
