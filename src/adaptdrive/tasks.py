"""Tasks of a daemon: steps that are taken again and again, and errors outside of every task."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Awaitable, Callable, Iterator
from typing import Any, NoReturn

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
