"""Stand-in for lists of floats in compiled code, and the compilation."""

from __future__ import annotations

from typing import Any

import numba

from adaptdrive_sim.compiled.room import new_vector

compiled = numba.njit(cache=True)
"""Like the interpreter: no reordering of sums, and division by zero is an error."""

inlined = numba.njit(cache=True, forceinline=True)
"""The same, compiled into each caller: lengths are known there, which halves the time."""


@inlined
def filled(value: float, count: int) -> Any:
    """`[value] * count`."""
    result = new_vector(count)
    for i in range(count):
        result[i] = value
    return result


@inlined
def copied(values: Any) -> Any:
    """`list(values)`, and `[a, b, c]` of a tuple."""
    result = new_vector(len(values))
    for i in range(len(values)):
        result[i] = values[i]
    return result


@inlined
def part(values: Any, begin: Any, end: Any) -> Any:
    """`values[begin:end]`."""
    first, last, _ = slice(begin, end).indices(len(values))
    result = new_vector(max(last - first, 0))
    for i in range(len(result)):
        result[i] = values[first + i]
    return result


@inlined
def overwrite(values: Any, begin: Any, end: Any, source: Any) -> None:
    """`values[begin:end] = source`, of as many."""
    first, last, _ = slice(begin, end).indices(len(values))
    for i in range(last - first):
        values[first + i] = source[i]


@inlined
def joined(first: Any, second: Any) -> Any:
    """`first + second`."""
    result = new_vector(len(first) + len(second))
    for i in range(len(first)):
        result[i] = first[i]
    for i in range(len(second)):
        result[len(first) + i] = second[i]
    return result
