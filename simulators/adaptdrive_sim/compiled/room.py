"""Room for vectors that live no longer than a slow period.

A slow step makes about a hundred vectors of a few numbers each. To ask the system for the memory
of each, to count its users and to give it back would take longer than what is done with them. So
they stand one behind the other in memory that is part of the compiled code, and are forgotten all
at once when the next slow period begins. A full room is an error.

The room belongs to one thread at a time: compiled code keeps the interpreter's lock.
"""

from __future__ import annotations

from typing import Any

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from adaptdrive_sim.compiled.lists import ListType, make_list

_NAME = "adaptdrive_room"
_PLACES = 65536
_VECTOR = ListType(types.float64)


@numba.njit(cache=True, forceinline=True)
def new_vector(count: int) -> Any:
    """Return a vector of so many numbers, whatever they are."""
    if not 0 <= count <= _PLACES - _taken():
        raise MemoryError("no room for a vector")
    return _take(count)


@numba.njit(cache=True, forceinline=True)
def forget_vectors() -> None:
    """Every vector that was made so far may be overwritten from now on."""
    _forget()


@intrinsic
def _taken(_: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ARG001
        return builder.load(_counter(builder))

    return types.intp(), generate


@intrinsic
def _forget(_: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ARG001
        builder.store(ir.Constant(ir.IntType(64), 0), _counter(builder))
        return context.get_dummy_value()

    return types.void(), generate


@intrinsic
def _take(_: Any, count: Any) -> Any:  # noqa: ARG001  # shows how it is called
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ARG001
        counter, (count,) = _counter(builder), args
        first = builder.load(counter)
        builder.store(builder.add(first, count), counter)
        place = cgutils.gep_inbounds(builder, _memory(builder), 0, 1, first)
        return make_list(context, builder, _VECTOR, place, count)

    return _VECTOR(types.intp), generate


def _counter(builder: Any) -> Any:
    """Return the address of the count of used places."""
    return cgutils.gep_inbounds(builder, _memory(builder), 0, 0)


def _memory(builder: Any) -> Any:
    """The counter and the places: one variable for all functions that are compiled together."""
    module = builder.module
    if _NAME in module.globals:
        return module.globals[_NAME]
    places = ir.ArrayType(ir.DoubleType(), _PLACES)
    kind = ir.LiteralStructType([ir.IntType(64), places])
    variable = ir.GlobalVariable(module, kind, _NAME)
    variable.linkage = "linkonce_odr"
    variable.initializer = ir.Constant(kind, None)
    return variable
