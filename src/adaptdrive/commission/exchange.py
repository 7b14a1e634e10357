"""Readings and the wanted voltage: the exchange of an experiment with a running drive."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from adaptdrive.operation.payloads import number, part


@dataclass(frozen=True, slots=True)
class FastReading:
    """One message of the fast loop.

    Attributes:
        time_s: Its time, in seconds of the wall clock.
        boost_voltage_V: v_bst.
        output: The regulated quantity.
        age_s: Time since they were measured.
        bridge: Whether the load is commanded on.
    """

    time_s: float
    boost_voltage_V: float
    output: float
    age_s: float
    bridge: bool

    @property
    def measured_s(self) -> float:
        """Time of the measurement, which several messages may show."""
        return self.time_s - self.age_s


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


def reading_of(content: dict[str, Any]) -> FastReading | None:
    """Return the reading of a message of `telemetry/drive`, None where something is missing."""
    try:
        time_s = datetime.fromisoformat(content["time"]).timestamp()
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    measured = number(content.get("boost_voltage_V")), number(content.get("output"))
    values = *measured, number(content.get("age_s"))
    if not all(map(math.isfinite, values)):
        return None
    return FastReading(time_s, *values, bridge=bool(part(content, "command").get("bridge")))
