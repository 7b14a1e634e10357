"""Lists of objects in compiled code: the objects of one layout, one behind the other.

A list is a pointer to its first object. It has a length, entries, and a place in loops and
comprehensions; its length never changes.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel.models import PrimitiveModel, StructModel
from numba.core.imputils import RefType, iternext_impl, lower_builtin
from numba.extending import intrinsic, overload, register_model

WORD = 8


class ObjectsType(types.IterableType):
    """Type of the lists of so many objects of one type."""

    def __init__(self, entry: Any, count: int) -> None:
        self.dtype, self.count = entry, count
        super().__init__(name=f"{count}_{entry.name}")

    @property
    def iterator_type(self) -> Any:
        """Type of an iterator over the list."""
        return EachType(self)


class EachType(types.UniTupleIter):
    """Type of the iterators over the lists of one type; comprehensions know those of tuples."""

    container_class: Any = ObjectsType


@register_model(ObjectsType)
class Pointer(PrimitiveModel):
    """An address in memory."""

    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, ir.IntType(8).as_pointer())


@register_model(EachType)
class _Each(StructModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        index = types.EphemeralPointer(types.intp)
        super().__init__(dmm, fe_type, [("objects", fe_type.container), ("index", index)])


@overload(len)
def _count(objects: Any) -> Any:
    if not isinstance(objects, ObjectsType):
        return None
    count = objects.count

    def found(objects: Any) -> Any:  # noqa: ARG001  # numba compares the names
        return count

    return found


@overload(operator.getitem)
def _entry(objects: Any, index: Any) -> Any:
    if not (isinstance(objects, ObjectsType) and isinstance(index, types.Integer)):
        return None
    count = objects.count

    def entry(objects: Any, index: Any) -> Any:
        place = index + count if index < 0 else index
        if place < 0 or place >= count:
            raise IndexError("list index out of range")
        return _at(objects, place)

    return entry


@intrinsic
def _at(_: Any, objects: Any, index: Any) -> Any:
    def generate(_: Any, builder: Any, __: Any, args: Any) -> Any:
        return _place(builder, objects, *args)

    return objects.dtype(objects, index), generate


def _place(builder: Any, objects: ObjectsType, pointer: Any, index: Any) -> Any:
    size = ir.Constant(index.type, objects.dtype.layout.words * WORD)
    return builder.gep(pointer, [builder.mul(index, size)])


@lower_builtin("getiter", ObjectsType)
def _begin(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    each = context.make_helper(builder, signature.return_type)
    each.objects = args[0]
    each.index = cgutils.alloca_once_value(builder, context.get_constant(types.intp, 0))
    return each._getvalue()  # noqa: SLF001


@lower_builtin("iternext", EachType)
@iternext_impl(RefType.BORROWED)
def _next(context: Any, builder: Any, signature: Any, args: Any, result: Any) -> None:
    (kind,) = signature.args
    each = context.make_helper(builder, kind, value=args[0])
    index = builder.load(each.index)
    more = builder.icmp_signed("<", index, context.get_constant(types.intp, kind.container.count))
    result.set_valid(more)
    with builder.if_then(more):
        result.yield_(_place(builder, kind.container, each.objects, index))
        builder.store(builder.add(index, context.get_constant(types.intp, 1)), each.index)
