"""What stands in for lists of floats in compiled code, and how code is compiled."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

compiled = numba.njit(cache=True, nogil=True, forceinline=True)
"""Like the interpreter: no reordering of sums, and division by zero is an error."""


@compiled
def filled(value: float, count: int) -> Any:
    """`[value] * count`."""
    result = np.empty(count, np.float64)
    for i in range(count):
        result[i] = value
    return result


@compiled
def vector(values: Any) -> Any:
    """`[a, b, c]` of a tuple."""
    result = np.empty(len(values), np.float64)
    for i in range(len(values)):
        result[i] = values[i]
    return result


@compiled
def copied(values: Any) -> Any:
    """`list(values)`, `values[a:b]`."""
    result = np.empty(len(values), np.float64)
    for i in range(len(values)):
        result[i] = values[i]
    return result


@compiled
def joined(first: Any, second: Any) -> Any:
    """`first + second`."""
    result = np.empty(len(first) + len(second), np.float64)
    for i in range(len(first)):
        result[i] = first[i]
    for i in range(len(second)):
        result[len(first) + i] = second[i]
    return result
