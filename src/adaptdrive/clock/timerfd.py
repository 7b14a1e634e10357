"""Linux timerfd for Python before 3.13: an absolute deadline that wakes the event loop.

asyncio's own timers round to a millisecond; a timer of the kernel on an absolute deadline does
not, and its file descriptor joins the event loop like any other.
"""

from __future__ import annotations

import ctypes
import os
import struct

from adaptdrive.clock.now import CLOCK

_TFD_NONBLOCK = os.O_NONBLOCK
_TFD_CLOEXEC = os.O_CLOEXEC
_TFD_TIMER_ABSTIME = 1

_SETTING = struct.Struct("@llll")
"""struct itimerspec: seconds and nanoseconds of the interval, then of the deadline."""

_libc = ctypes.CDLL(None, use_errno=True)
_settime = _libc.timerfd_settime


def create_timer() -> int:
    """Open a disarmed, non-blocking timer on the daemon's clock.

    Raises:
        OSError: The kernel gives none.
    """
    descriptor = int(_libc.timerfd_create(CLOCK, _TFD_NONBLOCK | _TFD_CLOEXEC))
    if descriptor < 0:
        raise OSError(ctypes.get_errno(), "timerfd_create failed")
    return descriptor


def arm_timer(descriptor: int, deadline_s: float) -> None:
    """Let the timer expire once at a time of that clock; at once when it is past, never for 0.

    Raises:
        OSError: The descriptor is no timer.
    """
    seconds = int(deadline_s)
    nanoseconds = int((deadline_s - seconds) * 1e9)
    setting = _SETTING.pack(0, 0, seconds, nanoseconds)
    if _settime(descriptor, _TFD_TIMER_ABSTIME, setting, None) != 0:
        raise OSError(ctypes.get_errno(), "timerfd_settime failed")


def acknowledge(descriptor: int) -> bool:
    """Take note of an expiry, so that the descriptor is no longer readable.

    Returns:
        Whether there was one. Arming a timer anew takes back an expiry that was not read yet.
    """
    try:
        os.read(descriptor, 8)
    except BlockingIOError:
        return False
    return True
