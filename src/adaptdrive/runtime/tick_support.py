"""Work between the ticks: preparation for the next frame, causes of late ticks, garbage."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator

from adaptdrive.hardware.port import Port
from adaptdrive.runtime.collector import IdleCollector
from adaptdrive.runtime.daemon_settings import DaemonSettings
from adaptdrive.runtime.frame_watch import DressRehearsal, FrameWatch
from adaptdrive.runtime.latency import LatencyDetector, WatchedLoop
from adaptdrive.runtime.reports import TickReport


class TickSupport:
    """Shortens the ticks of one drive, and explains the late ones."""

    def __init__(  # noqa: PLR0913 - one parameter for each interface
        self,
        loop: asyncio.AbstractEventLoop,
        settings: DaemonSettings,
        port: Port,
        *,
        rehearse: Callable[[], None],
        report_late: Callable[[str], None],
        report_unrehearsed: Callable[[str], None],
        is_idle: Callable[[], bool],
        clock: Callable[[], float],
    ) -> None:
        """Begin to note garbage collections, and expect no frame yet.

        Args:
            loop: Event loop of the port.
            settings: Times and thresholds.
            port: The drive.
            rehearse: Does what a tick does, and nothing that can be noticed.
            report_late: Receives the cause of a late tick.
            report_unrehearsed: Receives the error that has ended the rehearsals.
            is_idle: Returns whether the drive is off, so that a late tick does no harm.
            clock: Monotonic clock in seconds.
        """
        self._loop = loop
        self._settings = settings
        self._port = port
        self._rehearse = rehearse
        self._report_unrehearsed = report_unrehearsed
        self._is_idle = is_idle
        self._clock = clock
        self._collector = IdleCollector(settings.collect_ticks)
        ring = loop.ring if isinstance(loop, WatchedLoop) else None
        self._detector = LatencyDetector(settings.late_us, report_late, clock, ring)
        self._detector.open()
        self._expectant = list(self._get_ready())

    def expect(self, due_s: float) -> None:
        """Prepare for a frame that is due at a monotonic time."""
        for one in self._expectant:
            one.expect(due_s)

    def ticked(self, report: TickReport) -> None:
        """Look at a tick that has just ended."""
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
        """Collect garbage now that a tick has ended and the next one is far."""
        self._collector.collect(idle=self._is_idle())
