"""The black box: the last minute at full rate in memory, written with what follows a trip."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from pathlib import Path

import msgspec

from adaptdrive.recording.batches import Batch, EventRow, Header, framed
from adaptdrive.recording.writer_process import WriterProcess
from adaptdrive.runtime.reports import Severity

TRIP = "trip"
"""Kind of the event that has the black box written."""

_MODULE = "adaptdrive.recording.black_box_writer"
NO_FIGURE = "--no-figure"
"""Word of the command line without which the figure of a trip is drawn."""


class BlackBox:
    """Keeps recent batches, and has a process of their own write them after a trip."""

    def __init__(
        self,
        header: Header,
        report: Callable[[Severity, str], None],
        clock: Callable[[], float],
        *,
        before_s: float = 60.0,
        after_s: float = 10.0,
    ) -> None:
        """Begin to keep.

        Args:
            header: The session.
            report: Reports an event.
            clock: Monotonic clock in seconds.
            before_s: How far back the record of a trip goes.
            after_s: How long it goes on after the trip.
        """
        self.directory = ""
        """Folder of the session, empty while there is none."""
        self._header = header
        self._report = report
        self._clock = clock
        self._before_s = before_s
        self._after_s = after_s
        self._kept: deque[tuple[float, Batch]] = deque()
        self._tripped = asyncio.Event()

    def keep(self, batch: Batch) -> None:
        """Keep a batch; what is older than any trip may need is forgotten."""
        now_s = self._clock()
        self._kept.append((now_s, batch))
        while self._kept[0][0] < now_s - self._before_s - self._after_s:
            self._kept.popleft()
        if any(event.kind == TRIP for event in batch.events):
            self._tripped.set()

    async def run(self) -> None:
        """Write each trip, a while after it, until cancelled."""
        while True:
            await self._tripped.wait()
            await asyncio.sleep(self._after_s)
            await self.write_pending(timeout_s=60.0)

    async def write_pending(self, timeout_s: float, *, figure: bool = True) -> None:
        """Write the trip that is not written yet, if there is one.

        Args:
            timeout_s: Longest wait for the disk, and for the figure.
            figure: Whether to draw the figure, which takes some seconds.
        """
        if not self._tripped.is_set():
            return
        self._tripped.clear()
        try:
            async with asyncio.timeout(timeout_s):
                problem = await self._write(figure=figure)
        except TimeoutError:
            problem = f"the disk took longer than {timeout_s:g} s"
        except OSError as error:
            problem = str(error)
        if problem is not None:
            self._report(Severity.ALARM, f"the record of the trip is not written: {problem}")

    async def _write(self, *, figure: bool) -> str | None:
        words = () if figure else (NO_FIGURE,)
        writer = await WriterProcess.start(Path(self._header.sessions), _MODULE, *words)
        try:
            header = msgspec.structs.replace(self._header, directory=self.directory)
            writer.send(framed(header))
            for _, batch in self._kept:
                writer.send(framed(batch))
            writer.hang_up()
            async for news in writer.news():
                self._report(Severity(news.severity), news.detail)
            return await writer.ended()
        finally:
            await writer.kill()


def trip_of(events: list[EventRow]) -> EventRow | None:
    """Return the last trip among some events."""
    return next((event for event in reversed(events) if event.kind == TRIP), None)
