"""Room for vectors that live no longer than a slow period.

A slow step makes about a hundred vectors of a few numbers each. To ask the system for the memory
of each, to count its users and to give it back would take longer than what is done with them. So
they stand one behind the other in memory that is part of the compiled code, and are forgotten all
at once when the next slow period begins. When that memory is full, a vector gets separate memory.

The room belongs to one thread at a time: compiled code keeps the interpreter's lock.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import impl_ret_borrowed
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

_NAME = "adaptdrive_room"
_PLACES = 16384
_WORD = 8
_VECTOR = types.Array(types.float64, 1, "C")


@numba.njit(cache=True, forceinline=True)
def new_vector(count: int) -> Any:
    """Return a vector of so many numbers, whatever they are."""
    if count <= _PLACES - _taken():
        return _take(count)
    return np.empty(count, np.float64)


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
        array = make_array(_VECTOR)(context, builder)
        populate_array(
            array,
            data=cgutils.gep_inbounds(builder, _memory(builder), 0, 1, first),
            shape=[count],
            strides=[context.get_constant(types.intp, _WORD)],
            itemsize=context.get_constant(types.intp, _WORD),
            meminfo=None,
            parent=None,
        )
        return impl_ret_borrowed(context, builder, _VECTOR, array._getvalue())  # noqa: SLF001

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
