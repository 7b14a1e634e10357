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

_PLACES = 65536


@numba.njit(cache=True, forceinline=True)
def new_vector(count: int) -> Any:
    """Return a vector of so many numbers, whatever they are."""
    taken: Any = _taken()
    first = taken[0]
    if not 0 <= count <= _PLACES - first:
        raise MemoryError("no room for a vector")
    taken[0] = first + count
    return _vector(first, count)


@numba.njit(cache=True, forceinline=True)
def forget_vectors() -> None:
    """Every vector that was made so far may be overwritten from now on."""
    _taken()[0] = 0


@intrinsic
def _taken(_: Any) -> Any:
    """Return a list of one number: how many places are taken."""
    kind = ListType(types.intp)

    def generate(context: Any, builder: Any, _: Any, __: Any) -> Any:
        counter = _variable(builder, "adaptdrive_taken", ir.IntType(64))
        return make_list(context, builder, kind, counter, context.get_constant(types.intp, 1))

    return kind(), generate


@intrinsic
def _vector(_: Any, first: Any, count: Any) -> Any:
    """Return the list of so many places from one on."""
    kind = ListType(types.float64)

    def generate(context: Any, builder: Any, _: Any, args: Any) -> Any:
        places = _variable(builder, "adaptdrive_room", ir.ArrayType(ir.DoubleType(), _PLACES))
        place = cgutils.gep_inbounds(builder, places, 0, args[0])
        return make_list(context, builder, kind, place, args[1])

    return kind(first, count), generate


def _variable(builder: Any, name: str, kind: Any) -> Any:
    """Return the address of what all functions that are compiled together share."""
    module = builder.module
    if name in module.globals:
        return module.globals[name]
    variable = ir.GlobalVariable(module, kind, name)
    variable.linkage = "linkonce_odr"
    variable.initializer = ir.Constant(kind, None)
    return variable
