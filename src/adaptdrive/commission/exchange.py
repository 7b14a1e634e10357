"""Readings and the wanted voltage: the exchange of an experiment with a running drive."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from datetime import datetime
from typing import Any


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


def reading_of(content: dict[str, Any]) -> FastReading:
    """Return the reading of a message of `telemetry/drive`."""
    return FastReading(
        time_s=datetime.fromisoformat(content["time"]).timestamp(),
        boost_voltage_V=float(content["boost_voltage_V"]),
        output=float(content["output"]),
        bridge=bool(content["command"]["bridge"]),
    )
