"""Time, deadlines, and calls that may take too much of it.

asyncio's own timers round to a millisecond; a timer of the kernel on an absolute deadline does
not, and its file descriptor joins the event loop like any other.

The helper threads of the event loop are few, everything else that blocks needs them, and the
process cannot end before they do: a call to a name server or to a broken device takes minutes.
"""

import asyncio
import contextlib
import ctypes
import ipaddress
import os
import re
import socket
import struct
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from threading import Thread
from typing import Any, Final, NoReturn, TypeVar

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

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[float], None]) -> None:
        """Open the timer.

        Args:
            loop: Event loop to call back in.
            callback: Called with the deadline that has passed.
        """
        self._loop = loop
        self._callback = callback
        self._deadline_s = 0.0
        self._descriptor = create_timer()
        loop.add_reader(self._descriptor, self._expired)

    def arm(self, deadline_s: float) -> None:
        """Call back at `deadline_s`, at once when it is past."""
        self._deadline_s = deadline_s
        arm_timer(self._descriptor, deadline_s)

    def close(self) -> None:
        """Never call back again."""
        if self._descriptor >= 0:
            self._loop.remove_reader(self._descriptor)
            os.close(self._descriptor)
            self._descriptor = -1

    def _expired(self) -> None:
        if not acknowledge(self._descriptor):
            return  # armed anew since it woke the loop: by a frame that came in the same round
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


# Calls that may hang, each in a separate thread.

Result = TypeVar("Result")


def in_thread(call: Callable[[], Result], name: str) -> Future[Result]:
    """Start a call in a separate thread, for which the process need not wait.

    Args:
        call: What is called.
        name: Name of the thread.

    Returns:
        The result of the call, or the exception that it raised. It cannot be cancelled.
    """
    future: Future[Result] = Future()
    future.set_running_or_notify_cancel()  # whoever gives up cannot cancel it any more

    def run() -> None:
        try:
            result = call()
        except Exception as problem:  # noqa: BLE001 - passed to the caller
            future.set_exception(problem)
        else:
            future.set_result(result)

    Thread(target=run, name=name, daemon=True).start()
    return future


# Tasks of a daemon: steps that are taken again and again, and errors outside of every task.

Step = Callable[[], Awaitable[None]]
"""Does one thing, for as long as it takes."""


async def repeat(step: Step, pause_s: float) -> NoReturn:
    """Take a step and pause, again and again until cancelled.

    Args:
        step: What is done.
        pause_s: Time from the end of one step to the next.
    """
    while True:
        await step()
        await asyncio.sleep(pause_s)


@contextlib.contextmanager
def uncaught_errors_end(fail: Callable[[BaseException], None]) -> Iterator[None]:
    """Have errors of the loop's callbacks and of other threads end the daemon meanwhile.

    Args:
        fail: Makes the drive safe and ends the daemon; called in the running event loop.
    """
    loop, hook = asyncio.get_running_loop(), threading.excepthook

    def in_callback(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        problem = context.get("exception")
        if problem is not None and "handle" in context:
            fail(problem)
        loop.default_exception_handler(context)

    def in_thread(caught: threading.ExceptHookArgs) -> None:
        if caught.exc_value is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended: so has the daemon
                loop.call_soon_threadsafe(fail, caught.exc_value)
        hook(caught)

    loop.set_exception_handler(in_callback)
    threading.excepthook = in_thread
    try:
        yield
    finally:
        loop.set_exception_handler(None)
        threading.excepthook = hook


# Looking up the addresses of a host, which takes half a minute where no name server answers.

Addresses = tuple[str, ...]

_NAME = re.compile(r"(?=.{1,254}$)((?!-)[A-Za-z0-9_-]{1,63}(?<!-)(\.|$))+")
"""Labels with dots between them, and at the end or not; RFC 1035 allows 253 characters."""


def check_host(host: str) -> str:
    """Return a host that can be looked up.

    Args:
        host: Name or address.

    Raises:
        ValueError: It is neither an IP address nor a host name.
    """
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(host)
        return host
    name = ""
    with contextlib.suppress(UnicodeError):
        name = host.encode("idna").decode("ascii")
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"{host!r} is neither an IP address nor a host name: labels of 1 to 63 letters, digits "
            "and '-', separated by dots"
        )
    return host


def look_up(host: str, port: int) -> Future[Addresses]:
    """Start to look up the addresses of a host.

    Args:
        host: Name or address.
        port: TCP port.

    Returns:
        The addresses in the order in which they are to be tried, or the error: an OSError, or a
        ValueError where the name cannot be one. The process need not wait for it to end.
    """

    def addresses() -> Addresses:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        return tuple(dict.fromkeys(str(entry[4][0]) for entry in found))

    return in_thread(addresses, "look-up")


async def find(host: str, port: int, timeout_s: float) -> Addresses:
    """Return the addresses of a host, as `look_up` does.

    Args:
        host: Name or address.
        port: TCP port.
        timeout_s: Longest wait for a name server.

    Raises:
        OSError: There is no such host, or no name server answers in time.
        ValueError: The name cannot be one.
    """
    try:
        async with asyncio.timeout(timeout_s):
            return await asyncio.wrap_future(look_up(host, port))
    except TimeoutError as problem:
        raise TimeoutError(f"no name server answers within {timeout_s:g} s") from problem
