"""Using a bus for as long as it is there, and opening it again whenever it is lost."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import NoReturn

import can

from adaptdrive.errors import BusError

_FIRST_DELAY_S = 0.1
"""First wait before a lost bus is opened again: an interface that is restarted is soon back."""

_LAST_DELAY_S = 2.0
"""Longest wait: an adapter that is plugged in again should not be waited for."""

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
        lost: Told that the bus was lost, and why.
        returned: Told that it is in use again.
        heard: Counts frames: a bus that is open but mute is opened again less and less often.

    Raises:
        BusError: The bus cannot be opened at the first attempt.
    """
    problem = await serve(open_one(), opened)
    delay_s = _FIRST_DELAY_S
    while True:
        lost(problem)
        bus, delay_s = await _reopen(open_one, delay_s)
        before = heard()
        problem = await serve(bus, returned)
        if heard() > before:
            delay_s = _FIRST_DELAY_S


async def _reopen(open_one: Callable[[], can.BusABC], delay_s: float) -> tuple[can.BusABC, float]:
    """Try again, less and less often; the bus, and the delay for the next time."""
    while True:
        await asyncio.sleep(delay_s)
        delay_s = min(2.0 * delay_s, _LAST_DELAY_S)
        with contextlib.suppress(BusError):
            return open_one(), delay_s
