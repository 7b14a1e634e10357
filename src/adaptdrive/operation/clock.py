"""Wall-clock time, and whether it can be trusted."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from datetime import UTC, datetime
from enum import StrEnum

WallClock = Callable[[], datetime]
"""Returns the present time in UTC."""

Monotonic = Callable[[], float]
"""Returns seconds on a clock that never steps."""


class Synchronisation(StrEnum):
    """Synchronisation of the wall clock with a time source."""

    SYNCHRONISED = "synchronised"
    UNSYNCHRONISED = "unsynchronised"
    UNKNOWN = "unknown"


# struct timex takes 208 bytes on 64-bit kernels; more room does no harm, zeros ask and set nothing.
_TIMEX_BYTES = 512
_TIME_ERROR = 5


def utc_now() -> datetime:
    """The wall clock of this machine."""
    return datetime.now(UTC)


def kernel_synchronisation() -> Synchronisation:
    """Ask the kernel whether its clock is kept right by NTP, PTP or a radio clock."""
    try:
        answer = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (OSError, AttributeError):
        return Synchronisation.UNKNOWN
    if answer < 0:
        return Synchronisation.UNKNOWN
    return Synchronisation.UNSYNCHRONISED if answer == _TIME_ERROR else Synchronisation.SYNCHRONISED
