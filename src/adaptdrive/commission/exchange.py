"""Readings and the wanted voltage: the exchange of an experiment with a running drive."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from adaptdrive.operation.listener import number, part

_SLEW = 1.0e-3
"""Largest rate of a clock that is kept right, twice what NTP allows, as a share of the time."""


@dataclass(frozen=True, slots=True)
class FastReading:
    """One message of the fast loop.

    Attributes:
        time_s: Its time, in seconds of the wall clock.
        boost_voltage_V: v_bst.
        output: The regulated quantity.
        bridge: Whether the load is commanded on.
    """

    time_s: float
    boost_voltage_V: float
    output: float
    bridge: bool


class WantedVoltage:
    """The present voltage command of an experiment.

    Attributes:
        voltage_V: V_c.
        changed: Set when it changes.
    """

    def __init__(self, voltage_V: float) -> None:
        self.voltage_V = voltage_V
        self.changed = asyncio.Event()

    def change(self, voltage_V: float) -> None:
        """Take a voltage."""
        if voltage_V != self.voltage_V:
            self.voltage_V = voltage_V
            self.changed.set()


class ReadingClock:
    """The time of the readings beside a clock that nobody sets."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None

    def lead_s(self, time_s: float, now_s: float) -> float:
        """Return by how much the time of the readings has left the clock since the first reading.

        What a clock may drift until then, or be slewed, does not count.

        Args:
            time_s: Time of a reading.
            now_s: Time of its arrival by the clock that nobody sets.
        """
        self._first = self._first or (time_s, now_s)
        elapsed_s = now_s - self._first[1]
        lead_s = time_s - self._first[0] - elapsed_s
        return math.copysign(max(0.0, abs(lead_s) - _SLEW * elapsed_s), lead_s)


def reading_of(content: dict[str, Any]) -> FastReading | None:
    """Return the reading of a message of `telemetry/drive`, None where something is missing."""
    try:
        time_s = datetime.fromisoformat(content["time"]).timestamp()
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    values = number(content.get("boost_voltage_V")), number(content.get("output"))
    if not all(map(math.isfinite, values)):
        return None
    return FastReading(time_s, *values, bridge=bool(part(content, "command").get("bridge")))
