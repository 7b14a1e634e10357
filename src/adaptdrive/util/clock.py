"""The clock of the daemon, and deadlines that the kernel keeps and the event loop delivers.

asyncio's own timers round to a millisecond; a timer of the kernel on an absolute deadline does
not, and its file descriptor joins the event loop like any other.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Final

# The clock of the daemon: nobody sets it, and it counts the time that the machine is suspended.

CLOCK: Final = time.CLOCK_BOOTTIME
"""CLOCK_MONOTONIC stands still while the machine is suspended: a measurement from before would look
fresh afterwards, and nothing would tell that the daemon did not run."""

now_s: Final[Callable[[], float]] = partial(time.clock_gettime, CLOCK)
"""Return the time since the start of the machine, in s."""


# Linux timerfd for Python before 3.13: an absolute deadline that wakes the event loop.

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


# Deadlines, kept by the kernel and delivered in the event loop: one at a time, or on a grid.


class TickTimer:
    """Calls back at an absolute time of the daemon's clock; arming again replaces the deadline."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        callback: Callable[[float], None],
        spin_s: float = 0.0,
    ) -> None:
        """Open the timer.

        Args:
            loop: Event loop to call back in.
            callback: Called with the deadline that has passed.
            spin_s: Wake up so much earlier, and wait for the deadline without giving up the CPU.
        """
        self._loop = loop
        self._callback = callback
        self._spin_s = spin_s
        self._deadline_s = 0.0
        self._descriptor = create_timer()
        loop.add_reader(self._descriptor, self._expired)

    def arm(self, deadline_s: float) -> None:
        """Call back at `deadline_s`, at once when it is past."""
        self._deadline_s = deadline_s
        arm_timer(self._descriptor, deadline_s - self._spin_s)

    def close(self) -> None:
        """Never call back again."""
        if self._descriptor >= 0:
            self._loop.remove_reader(self._descriptor)
            os.close(self._descriptor)
            self._descriptor = -1

    def _expired(self) -> None:
        if not acknowledge(self._descriptor):
            return  # armed anew since it woke the loop: by a frame that came in the same round
        while now_s() < self._deadline_s:
            pass
        self._callback(self._deadline_s)


@contextmanager
def pulsing(period_s: float, *due: Callable[[], object]) -> Iterator[None]:
    """Call back on a grid until the block ends; deadlines that the process slept over are skipped.

    Args:
        period_s: Time from one call to the next, in s; the first is one period away.
        due: Called each time, in this order; must return at once.
    """

    def expired(deadline_s: float) -> None:
        skipped = max(0, int((now_s() - deadline_s) / period_s))
        timer.arm(deadline_s + (1 + skipped) * period_s)
        for call in due:
            call()

    timer = TickTimer(asyncio.get_running_loop(), expired)
    if due:
        timer.arm(now_s() + period_s)
    try:
        yield
    finally:
        timer.close()
