"""Reset of a drive's fault by a part of its command: on for a moment, and off again.

No tick commands it: an operator asks for it while the drive is off.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

from adaptdrive.devices.binding import Sink

_READINGS = 3.0
"""Readings for which each level lasts: a drive that is polled takes one command in each."""

_LEAST_S = 0.1
"""Shortest time of a level: drives look at such a bit every few milliseconds."""


async def pulse_reset(sinks: Iterable[Sink[Any]], reading_s: float) -> None:
    """Switch the reset of a fault on and off with the next commands; nothing where there is none.

    Args:
        sinks: All parts of the command.
        reading_s: Time from one reading of the drive to the next.
    """
    resets = [sink.reset for sink in sinks if sink.reset is not None]
    level_s = max(_LEAST_S, _READINGS * reading_s)
    for level in (True, False) if resets else ():
        try:
            for reset in resets:
                reset.on = level
            await asyncio.sleep(level_s)
        finally:
            for reset in resets:
                reset.on = False
