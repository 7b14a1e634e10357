"""Drawing of a view on a terminal that may be stopped or gone, and the orderly end of the view.

Whoever looks is told by lines on standard error; a terminal that is stopped takes none.
"""

from __future__ import annotations

import asyncio
import functools
import os
import signal
import sys
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn

from rich.console import Console
from rich.layout import Layout
from rich.live import Live

from adaptdrive.util.errors import ConfigurationError, Flaw
from adaptdrive.util.threads import in_thread

# The end of a view that commands a drive: once it is asked for, nothing cuts it short.

LONGEST_S = 1.0
"""Longest wait for a terminal to take what is written last."""

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def ended_once() -> Iterator[None]:
    """Cancel the present task at the first signal that ends a program, and ignore all later ones.

    A signal that the process was started to ignore stays ignored.

    Raises:
        KeyboardInterrupt: A signal came, and the task has ended by it.
    """
    task, loop = asyncio.current_task(), asyncio.get_running_loop()
    assert task is not None  # noqa: S101 - a view runs in a task
    asked = False

    def end(_number: int, _frame: FrameType | None) -> None:
        nonlocal asked
        if not asked:
            asked = True
            task.cancel()
            loop.call_soon_threadsafe(lambda: None)  # the loop may be asleep

    heeded = [one for one in _ENDING if signal.getsignal(one) is not signal.SIG_IGN]
    usual = {one: signal.signal(one, end) for one in heeded}
    try:
        yield
    except asyncio.CancelledError:
        if asked:
            raise KeyboardInterrupt from None
        raise
    finally:
        for one, handler in usual.items():
            signal.signal(one, handler)


async def whole(work: Coroutine[Any, Any, None], *, complete: bool) -> None:
    """Await work that no cancellation interrupts.

    Args:
        work: What is awaited.
        complete: Whether a cancellation counts for nothing; else it counts when the work is done.

    Raises:
        CancelledError: The present task was cancelled meanwhile.
    """
    task, cancelled = asyncio.create_task(work), False
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError:
            cancelled = True
    if cancelled and not complete:
        raise asyncio.CancelledError
    task.result()


def tell(text: str) -> Future[None]:
    """Write a line, in a thread that may hang."""
    return in_thread(functools.partial(_ending_write, f"{text}\n"), "adaptdrive-line")


def tell_last(text: str) -> None:
    """Write lines before the process ends, unless the terminal is gone or takes none."""
    with suppress(OSError, TimeoutError):
        tell(text).result(LONGEST_S)


def _ending_write(text: str) -> None:
    """Write to a separate descriptor: at its end Python waits for a stream that is in use."""
    encoding, errors = sys.stderr.encoding, sys.stderr.errors
    with os.fdopen(os.dup(sys.stderr.fileno()), "w", encoding=encoding, errors=errors) as output:
        output.write(text)


# Drawing of a view on a terminal, which may be stopped or gone.

REFRESH_S = 0.25


def refuse_dumb_terminal() -> None:
    """Refuse a terminal in which the cursor cannot be moved.

    Raises:
        ConfigurationError: The environment names such a terminal.
    """
    if Console(force_terminal=True).is_dumb_terminal:
        flaw = Flaw(os.environ["TERM"], "a terminal of this kind shows no picture")
        raise ConfigurationError("TERM", [flaw])


async def draw(screen_of: Callable[[tuple[int, int]], Layout]) -> NoReturn:
    """Fill the terminal four times a second, until cancelled.

    A terminal that takes no output, such as one that is stopped or behind a lost connection, holds
    up nothing but its picture: a thread writes to it.

    Args:
        screen_of: Returns the screen for a terminal of some width and height, in characters.

    Raises:
        ConfigurationError: The terminal shows no picture.
    """
    refuse_dumb_terminal()
    # one column for each letter that the terminal does not have, too
    output = os.fdopen(
        os.dup(sys.stdout.fileno()), "w", encoding=sys.stdout.encoding, errors="replace"
    )
    console = Console(file=output, force_terminal=True)
    live = Live(
        console=console,
        screen=True,
        auto_refresh=False,
        redirect_stdout=False,
        redirect_stderr=False,
    )
    try:
        await _write(live.start)
        while True:
            shown = screen_of((console.size.width, console.size.height))
            await _write(functools.partial(live.update, shown, refresh=True))
            await asyncio.sleep(REFRESH_S)
    finally:
        with suppress(TimeoutError, OSError):
            await asyncio.wait_for(_write(live.stop), LONGEST_S)
            output.close()


def _write(call: Callable[[], None]) -> asyncio.Future[None]:
    """Write to the terminal, in a thread that may hang."""
    return asyncio.wrap_future(in_thread(call, "adaptdrive-screen"))
