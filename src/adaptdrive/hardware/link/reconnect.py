"""Using a bus for as long as it is there, and opening it again whenever it is lost."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import NoReturn

import can

from adaptdrive.errors import BusError
from adaptdrive.hardware.backoff import BusBackoff

Serve = Callable[[can.BusABC, Callable[[], None]], Awaitable[str]]


async def serve_for_ever(  # noqa: PLR0913 - each turn in the life of a bus
    open_one: Callable[[], can.BusABC],
    serve: Serve,
    opened: Callable[[], None],
    *,
    lost: Callable[[str], None],
    returned: Callable[[], None],
    heard: Callable[[], int],
) -> NoReturn:
    """Serve one bus after the other until cancelled.

    Args:
        open_one: Opens the bus.
        serve: Uses an open bus until it is lost, and closes it; it calls what it is given when it
            has begun, and gives the reason of the loss.
        opened: Called once, when the bus is in use for the first time.
        lost: Called with the reason when the bus was lost.
        returned: Called when the bus is open again.
        heard: Counts frames: a bus that is open but mute is opened again less and less often.

    Raises:
        BusError: The bus cannot be opened at the first attempt.
    """
    problem = await serve(open_one(), opened)
    backoff = BusBackoff()
    while True:
        lost(problem)
        bus = await _reopen(open_one, backoff)
        before = heard()
        problem = await serve(bus, returned)
        if heard() > before:
            backoff.reset()


async def _reopen(open_one: Callable[[], can.BusABC], backoff: BusBackoff) -> can.BusABC:
    """Try again, less and less often."""
    while True:
        await asyncio.sleep(backoff.next_s())
        with contextlib.suppress(BusError):
            return open_one()
