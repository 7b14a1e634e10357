"""The readings of an experiment: none is old, and their time passes as it does here."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from adaptdrive.config.services import Mqtt
from adaptdrive.mqtt.client import NoAnswerError, telemetry
from adaptdrive.mqtt.commands import number, part
from adaptdrive.util.errors import CommissionError

_SILENCE_S = 4.0
"""Longest time without telemetry, and without a measurement in it; largest step of its time."""

_SAME_S = 0.03
"""Largest difference of the published times of one measurement; telemetry comes 0.1 s apart."""

_SLEW = 1.0e-3
"""Largest rate of a clock that is kept right, twice what NTP allows, as a share of the time."""


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


async def fast_readings(broker: Mqtt, drive: str) -> AsyncGenerator[FastReading, None]:
    """Yield one reading for each measurement of a drive, in the order of their times.

    A drive that is polled slowly shows a measurement in several messages. One of them is yielded
    again where its bridge was switched.

    Args:
        broker: The broker.
        drive: Name of the drive.

    Raises:
        NoAnswerError: The newest measurement is too old.
        CommissionError: A clock was set.
    """
    now = asyncio.get_running_loop().time
    last_s, heard_s, clock = -math.inf, now(), ReadingClock()
    last: FastReading | None = None
    async with aclosing(telemetry(broker, drive)) as messages:
        while True:
            name, content = await _next(messages, drive)
            reading = reading_of(content) if name == "drive" else None
            if reading is not None:
                now_s = now()
                _look_at_time(drive, clock.lead_s(reading.time_s, now_s))
                if reading.time_s > last_s:
                    last_s, heard_s = reading.time_s, now_s - reading.age_s
                    if last is None or _is_news(reading, last):
                        last = reading
                        yield reading
            if now() - heard_s > _SILENCE_S:
                silence = f"no measurement for {_SILENCE_S:g} s: adaptdrive probe shows why"
                raise NoAnswerError(drive, silence)


class ReadingClock:
    """The time of the readings, with a clock that nobody sets."""

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


async def _next(
    messages: AsyncIterator[tuple[str, dict[str, Any]]], drive: str
) -> tuple[str, dict[str, Any]]:
    """Return the next message, which must come in time."""
    try:
        async with asyncio.timeout(_SILENCE_S):
            return await anext(messages)
    except TimeoutError as problem:
        raise NoAnswerError(drive, f"no telemetry for {_SILENCE_S:g} s") from problem


def _is_news(reading: FastReading, last: FastReading) -> bool:
    """Return whether a reading shows another measurement than the last one, or another bridge."""
    return reading.measured_s - last.measured_s > _SAME_S or reading.bridge != last.bridge


def _look_at_time(drive: str, lead_s: float) -> None:
    if abs(lead_s) > _SILENCE_S:
        raise CommissionError(
            f"the time of {drive}'s telemetry moved by {lead_s:+.4g} s against this program's "
            "clock: a clock was set, or messages come late"
        )
