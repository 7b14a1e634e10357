"""Drawing of a view on a terminal, which may be stopped or gone."""

from __future__ import annotations

import asyncio
import functools
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

from rich.console import Console
from rich.layout import Layout
from rich.live import Live

from adaptdrive.aside import in_thread
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.watch.ending import LONGEST_S

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
