"""The black box: the last minute at full rate in memory, written with what follows a trip."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from adaptdrive.recording.batches import Batch, Header, framed
from adaptdrive.recording.writer_process import WriterProcess
from adaptdrive.runtime.reports import Severity

TRIP = "trip"
"""Kind of the event that has the black box written."""

_MODULE = "adaptdrive.recording.black_box_writer"
NO_FIGURE = "--no-figure"
"""Word of the command line without which the figure of a trip is drawn."""

_PATIENCE_S = 60.0
"""Longest wait for the disk, and for the figure, while the daemon runs."""

_BEFORE_S = 60.0
"""Time before a trip that its record begins."""


@dataclass(frozen=True, slots=True)
class _Trip:
    """A trip whose record is not on disk yet.

    Attributes:
        number: Running number of its event in the session.
        time_s: When it was heard of, monotonic.
    """

    number: int
    time_s: float


class BlackBox:
    """Keeps recent batches, and has a process of their own write them after each trip."""

    def __init__(
        self,
        header: Header,
        report: Callable[[Severity, str], None],
        clock: Callable[[], float],
        *,
        after_s: float = 10.0,
    ) -> None:
        """Begin to keep.

        Args:
            header: The session.
            report: Reports an event.
            clock: Monotonic clock in seconds.
            after_s: How long it goes on after the trip.
        """
        self.directory = ""
        """Folder of the session, empty while there is none."""
        self._header = header
        self._report = report
        self._clock = clock
        self._after_s = after_s
        self._kept: deque[tuple[float, Batch]] = deque()
        self._trips: deque[_Trip] = deque()
        self._tripped = asyncio.Event()
        self._newest = 0

    def keep(self, batch: Batch) -> None:
        """Keep a batch; what is older than any trip may need is forgotten."""
        now_s = self._clock()
        self._kept.append((now_s, batch))
        # twice as long as a record: one may have to wait for the one before it
        while self._kept[0][0] < now_s - 2.0 * (_BEFORE_S + self._after_s):
            self._kept.popleft()
        for event in batch.events:
            # a batch that was refused comes again with its events
            if event.kind == TRIP and event.number > self._newest:
                self._newest = event.number
                self._trips.append(_Trip(event.number, now_s))
                self._tripped.set()

    async def run(self) -> None:
        """Write each trip, a while after it, until cancelled."""
        while True:
            await self._tripped.wait()
            while self._trips:
                trip = self._trips[0]
                await asyncio.sleep(max(0.0, trip.time_s + self._after_s - self._clock()))
                await self._write(trip, _PATIENCE_S)
            self._tripped.clear()

    async def finish(self, timeout_s: float) -> None:
        """Write the trips that are not written yet; `run` must have ended.

        Args:
            timeout_s: Longest wait for the disk; there is no time for a figure.
        """
        end_s = self._clock() + timeout_s
        while self._trips:
            await self._write(self._trips[0], max(0.0, end_s - self._clock()), NO_FIGURE)

    async def _write(self, trip: _Trip, timeout_s: float, *words: str) -> None:
        """Write one trip, which stays to be written where this is cancelled before its end."""
        problem: str | None
        try:
            async with asyncio.timeout(timeout_s):
                problem = await self._have_written(trip, *words)
        except TimeoutError:
            problem = f"it took longer than {timeout_s:.3g} s" if timeout_s else "no time was left"
        except OSError as error:
            problem = str(error)
        if self._done(trip):
            self._report(Severity.ALARM, f"the record of the trip is not written: {problem}")

    async def _have_written(self, trip: _Trip, *words: str) -> str | None:
        """Run the process that writes; why it failed."""
        sessions = Path(self._header.sessions)
        writer = await WriterProcess.start(sessions, _MODULE, str(trip.number), *words)
        try:
            self._send(trip, writer)
            async for news in writer.news():
                self._done(trip)
                self._report(Severity(news.severity), news.detail)
            return await writer.ended()
        finally:
            await writer.kill()

    def _send(self, trip: _Trip, writer: WriterProcess) -> None:
        header = msgspec.structs.replace(self._header, directory=self.directory)
        writer.send(framed(header))
        begin_s, end_s = trip.time_s - _BEFORE_S, trip.time_s + self._after_s
        for time_s, batch in self._kept:
            if begin_s <= time_s <= end_s:
                writer.send(framed(batch))
        writer.hang_up()

    def _done(self, trip: _Trip) -> bool:
        """Take a trip off those to be written; False where it is not among them."""
        if trip not in self._trips:
            return False
        self._trips.remove(trip)
        return True
