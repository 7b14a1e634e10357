"""Calls that may hang, look-ups of hosts among them, and tasks that are taken again and again.

The helper threads of the event loop are few, everything else that blocks needs them, and the
process cannot end before they do: a call to a name server or to a broken device takes minutes.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import Future
from threading import Thread
from typing import Any, NoReturn, TypeVar

# Calls that may hang, each in a separate thread, and tasks that are taken again and again.

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
