"""Work between the ticks: preparation for the next frame, causes of late ticks, garbage."""

from __future__ import annotations

import asyncio
import gc
import math
from collections.abc import Callable, Iterator

from adaptdrive.clock.tick_timer import TickTimer
from adaptdrive.hardware.port import Port
from adaptdrive.runtime.accounts import Announcer
from adaptdrive.runtime.latency import LatencyDetector, WatchedLoop
from adaptdrive.runtime.loop_interface import DaemonSettings
from adaptdrive.runtime.reports import Severity, TickReport

COLLECT_TICKS = 240
"""Ticks between two collections: one in two seconds."""

_MIDDLE_EVERY = 10
"""Collections of the youngest objects to one of the middle ones: the ratio of Python's own."""

_FULL_EVERY = 300
"""Least collections between two full ones: each takes 10 ms and more, even with the drive off."""


class IdleCollector:
    """Collects garbage in the slack after a tick, in place of Python's own bad moments.

    While a drive runs, only young objects are looked at: a full collection takes as long as
    everything that lives is large, ten milliseconds and more with many commands remembered. It
    waits until the drive is off.
    """

    def __init__(self, every_ticks: int) -> None:
        """Collect nothing yet.

        Args:
            every_ticks: Ticks from one collection to the next; 0 for never.
        """
        self._every = every_ticks
        self._waited = 0
        self._collections = 0
        self._since_full = 0

    def is_due(self) -> bool:
        """Count a tick; whether a collection is due after it."""
        self._waited += 1
        if not self._every or self._waited < self._every:
            return False
        self._waited = 0
        return True

    def collect(self, *, idle: bool) -> int:
        """Collect what became garbage since the freeze.

        Args:
            idle: Whether the drive is off, so that a late tick does no harm.

        Returns:
            The generation that was collected.
        """
        self._collections += 1
        self._since_full += 1
        generation = 0 if self._collections % _MIDDLE_EVERY else 1
        if idle and self._since_full >= _FULL_EVERY:
            self._since_full, generation = 0, 2
        gc.collect(generation)
        return generation


class _Expectant:
    """Does something shortly before each frame is due."""

    def __init__(self, loop: asyncio.AbstractEventLoop, lead_s: float) -> None:
        self._lead_s = lead_s
        self._due_s = math.nan
        self._timer = TickTimer(loop, self._expired)
        self._ended = False

    def expect(self, due_s: float) -> None:
        """Await a frame that is due at a monotonic time."""
        self._due_s = due_s
        if not self._ended:
            self._timer.arm(due_s - self._lead_s)

    def close(self) -> None:
        """Await nothing any more."""
        self._ended = True
        self._timer.close()

    def _expired(self, _: float) -> None:
        raise NotImplementedError


class FrameWatch(_Expectant):
    """Looks at the bus again and again from shortly before a frame is due until it has come.

    There is then nothing to wake up from.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        look: Callable[[], None],
        spin_s: float,
        clock: Callable[[], float],
    ) -> None:
        """Expect nothing yet.

        Args:
            loop: Event loop of the port.
            look: Passes arrived frames on; the receiver of a frame calls `expect` again.
            spin_s: How long before a frame is due the wait begins, and after it ends.
            clock: Monotonic clock in seconds.
        """
        super().__init__(loop, spin_s)
        self._look = look
        self._clock = clock

    def _expired(self, _: float) -> None:
        due_s = self._due_s
        while self._due_s == due_s and self._clock() < due_s + self._lead_s:
            self._look()


class DressRehearsal(_Expectant):
    """Rehearses a tick shortly before a frame is due: the CPU's caches then hold what it needs.

    Of all the time that a tick takes after a sleep, most is spent waiting for memory.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        rehearse: Callable[[], None],
        look: Callable[[], None],
        report_end: Callable[[str], None],
        lead_s: float,
    ) -> None:
        """Expect nothing yet.

        Args:
            loop: Event loop of the port.
            rehearse: Does what a tick does, and nothing that can be noticed.
            look: Reads the bus after it, which has no frame yet.
            report_end: Receives the error of a rehearsal that fails, which is the last one.
            lead_s: How long before a frame is due.
        """
        super().__init__(loop, lead_s)
        self._rehearse = rehearse
        self._look = look
        self._report_end = report_end

    def _expired(self, _: float) -> None:
        """Rehearse, and read the bus; no rehearsal that fails is worth a drive that stops."""
        try:
            self._rehearse()
        except Exception as problem:  # noqa: BLE001 - without it ticks only take longer
            self.close()
            self._report_end(repr(problem))
        self._look()


class TickSupport:
    """Shortens the ticks of one drive, and explains the late ones."""

    def __init__(
        self,
        settings: DaemonSettings,
        port: Port,
        announcer: Announcer,
        rehearse: Callable[[], None],
        clock: Callable[[], float],
    ) -> None:
        """Begin to note garbage collections in the running loop, and expect no frame yet.

        Args:
            settings: Times and thresholds.
            port: The drive.
            announcer: Publishes causes of late ticks, and the error that has ended the rehearsals.
            rehearse: Does what a tick does, and nothing that can be noticed.
            clock: Monotonic clock in seconds.
        """
        self._loop = loop = asyncio.get_running_loop()
        self._settings = settings
        self._port = port
        self._announcer = announcer
        self._rehearse = rehearse
        self._clock = clock
        self._collector = IdleCollector(COLLECT_TICKS if settings.realtime.freeze_gc else 0)
        ring = loop.ring if isinstance(loop, WatchedLoop) else None
        self._detector = LatencyDetector(settings.realtime.late_us, self._report_late, clock, ring)
        self._detector.open()
        self._expectant = list(self._get_ready())

    def expect(self, due_s: float) -> None:
        """Prepare for a frame that is due at a monotonic time."""
        for one in self._expectant:
            one.expect(due_s)

    def ticked(self, report: TickReport) -> None:
        """Look at a tick that has just ended; the next one is far."""
        self._detector.ticked(report.lateness_us, report.tick_us)
        if self._collector.is_due():
            self._loop.call_soon(self._collect)

    def close(self) -> None:
        """Prepare for nothing any more, and note nothing."""
        for one in self._expectant:
            one.close()
        self._detector.close()

    def _get_ready(self) -> Iterator[_Expectant]:
        """Yield what prepares for each frame of a drive that sends cyclically."""
        realtime, look = self._settings.realtime, self._port.catch_up
        if self._settings.fast.timing.ticks_per_reading > 1:
            # the replies of a drive that is polled come through the loop, which must not be kept
            return
        if realtime.rehearse_us > 0.0:
            lead_s, report_end = realtime.rehearse_us * 1e-6, self._report_unrehearsed
            yield DressRehearsal(self._loop, self._rehearse, look, report_end, lead_s)
        if realtime.spin_us > 0.0:
            yield FrameWatch(self._loop, look, realtime.spin_us * 1e-6, self._clock)

    def _collect(self) -> None:
        """Collect garbage; a late tick does no harm while the drive is off."""
        self._collector.collect(idle=not self._announcer.published.enabled)

    def _report_late(self, detail: str) -> None:
        self._announcer.publish_event("latency", Severity.WARNING, detail)

    def _report_unrehearsed(self, problem: str) -> None:
        detail = f"rehearse_us has no effect any more: {problem}"
        self._announcer.publish_event("realtime", Severity.WARNING, detail)
