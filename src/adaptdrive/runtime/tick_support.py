"""Work between the ticks: preparation for the next frame, causes of late ticks, garbage."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator

from adaptdrive.hardware.port import Port
from adaptdrive.runtime.announcer import Announcer
from adaptdrive.runtime.collector import IdleCollector
from adaptdrive.runtime.frame_watch import DressRehearsal, FrameWatch
from adaptdrive.runtime.latency import LatencyDetector, WatchedLoop
from adaptdrive.runtime.loop_interface import DaemonSettings
from adaptdrive.runtime.reports import Severity, TickReport


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
        self._collector = IdleCollector(settings.collect_ticks)
        ring = loop.ring if isinstance(loop, WatchedLoop) else None
        self._detector = LatencyDetector(settings.late_us, self._report_late, clock, ring)
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

    def _get_ready(self) -> Iterator[DressRehearsal | FrameWatch]:
        """Yield what prepares for each frame of a drive that sends cyclically."""
        settings, look = self._settings, self._port.catch_up
        if settings.fast.timing.ticks_per_reading > 1:
            # the replies of a drive that is polled come through the loop, which must not be kept
            return
        if settings.rehearse_s > 0.0:
            yield DressRehearsal(
                self._loop, self._rehearse, look, self._report_unrehearsed, settings.rehearse_s
            )
        if settings.spin_s > 0.0:
            yield FrameWatch(self._loop, look, settings.spin_s, self._clock)

    def _collect(self) -> None:
        """Collect garbage; a late tick does no harm while the drive is off."""
        self._collector.collect(idle=not self._announcer.published.enabled)

    def _report_late(self, detail: str) -> None:
        self._announcer.publish_event("latency", Severity.WARNING, detail)

    def _report_unrehearsed(self, problem: str) -> None:
        detail = f"rehearse_us has no effect any more: {problem}"
        self._announcer.publish_event("realtime", Severity.WARNING, detail)
