"""A port without a bus: readings are put in by hand, commands come out of a callback."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from adaptdrive.control.signals import Command, Decision, Snapshot
from adaptdrive.devices.port import Listener, PortStatistics
from adaptdrive.runtime.reports import TickReport
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.monitor import Monitor
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip

_TIMING = Timing(1.0 / 120.0, 0.05)


class LoopbackPort:
    """A port for tests and notebooks.

    Attributes:
        description: The bus in one phrase for people.
        counter_modulus: Where the counter of the readings wraps, None when they carry none.
        trip_cause: Why the drive must not be energised; set it to whatever it shall say.
        monitor: What the drive has reported; the safe command is taken at once, before all time.
    """

    description = "loopback"

    def __init__(
        self,
        commanded: Callable[[Command], None],
        *,
        counter_modulus: int | None = 65536,
        timing: Timing = _TIMING,
        slack_s: float | None = 0.0,
    ) -> None:
        """Build a port.

        Args:
            commanded: Called with each command that is sent.
            counter_modulus: Where the counter of the readings wraps.
            timing: Times of the drive.
            slack_s: None makes a drive that never says whether its bridge is on.
        """
        self.counter_modulus = counter_modulus
        self._commanded = commanded
        self._listener: Listener | None = None
        self.trip_cause: Trip | None = None
        self.monitor = Monitor(timing, lambda: -math.inf, slack_s=slack_s)
        self._up = False
        self._received = self._sent = self._dropped = self._reconnects = 0

    @property
    def statistics(self) -> PortStatistics:
        """Counts since the port was built."""
        return PortStatistics(
            received=self._received,
            sent=self._sent,
            send_drops=self._dropped,
            reconnects=self._reconnects,
        )

    async def run(self, listener: Listener, opened: Callable[[], None]) -> None:
        """Serve `listener` until cancelled.

        Args:
            listener: Who is told what is delivered.
            opened: Called once, at the start.
        """
        self._listener = listener
        self._up = True
        try:
            opened()
            await asyncio.Event().wait()
        finally:
            self._listener = None
            self._up = False

    def send(self, command: Command) -> bool:
        """Hand one command to the callback; False while the bus is down."""
        if not self._up:
            self.monitor.command(command)
            self._dropped += 1
            return False
        self._sent += 1
        self._commanded(command)
        self.monitor.command(command)
        self.monitor.take(command)
        return True

    def catch_up(self) -> None:
        """What is delivered is handed over at once."""

    def explain_age(self) -> None:
        """Name nothing: the readings come from outside, whole."""

    def details(self) -> list[str]:
        """Nothing is refused."""
        return []

    async def reset_fault(self) -> None:
        """Who delivers the readings decides what becomes of a fault."""

    def deliver(self, reading: Reading) -> None:
        """Hand a reading to the listener, as if the drive had sent it; lost while down."""
        if self._listener and self._up:
            self._received += 1
            came_s = reading.arrival_s if reading.bridge_s is None else reading.bridge_s
            asked_s = reading.bridge_reported_s
            self.monitor.report(on=reading.bridge, asked_s=asked_s, came_s=came_s)
            self._listener.on_reading(reading)

    def lose(self, detail: str = "loopback: lost") -> None:
        """Take the bus down."""
        self._up = False
        if self._listener:
            self._listener.on_bus(up=False, detail=detail)

    def restore(self) -> None:
        """Bring the bus up, also where nobody is served yet."""
        self._up = True
        self.monitor.lose()
        if self._listener:
            self._reconnects += 1
            self._listener.on_bus(up=True, detail=self.description)


class Quiet:
    """Surroundings of a fast loop that keep nothing.

    Attributes:
        now: The time, which passes as a test sets it.
    """

    now: float

    def now_s(self) -> float:
        """Return the time."""
        return self.now

    def arm(self, deadline_s: float) -> None:
        """No frame is late."""

    def met_deadline(self, now_s: float) -> None:
        """Nobody waits for it."""

    def ticked(self, report: TickReport) -> None:
        """Nobody records it."""

    def decided(self, snapshot: Snapshot, decision: Decision) -> None:
        """Nobody is told."""

    def not_stopped(self, problem: Trip) -> None:
        """Nobody listens."""

    def run_ended(self) -> None:
        """Nothing is kept."""
