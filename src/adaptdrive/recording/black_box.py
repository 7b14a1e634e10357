"""The black box: the last minute at full rate in memory, written with what follows a trip."""

from __future__ import annotations

import asyncio
import contextlib
import errno
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec

from adaptdrive.aside import Result, in_thread
from adaptdrive.errors import reason_of
from adaptdrive.recording.batches import Batch, Header, framed
from adaptdrive.recording.left_trips import (
    DamagedTripError,
    leave,
    left_path,
    left_trips,
    read_left,
    remove_unfinished,
)
from adaptdrive.recording.session import set_aside
from adaptdrive.recording.writer_process import WriterProcess
from adaptdrive.runtime.reports import Severity

TRIP = "trip"
"""Kind of the event that has the black box written."""

_MODULE = "adaptdrive.recording.black_box_writer"
NO_FIGURE = "--no-figure"
"""Word of the command line without which the figure of a trip is drawn."""

_UNWRITTEN = "the record of the trip is not written"
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
        start_thread: Callable[[], None] = lambda: None,
    ) -> None:
        """Begin to keep.

        Args:
            header: The session.
            report: Reports an event.
            clock: Monotonic clock in seconds.
            after_s: How long it goes on after the trip.
            start_thread: What a thread that reads or writes does first.
        """
        self.directory = ""
        """Folder of the session, empty while there is none."""
        self._header = header
        self._report = report
        self._clock = clock
        self._after_s = after_s
        self._start_thread = start_thread
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
        """Write what an earlier run has left, then each trip, a while after it, until cancelled."""
        await self._write_left()
        while True:
            await self._tripped.wait()
            await self._write_trips()
            self._tripped.clear()

    async def _write_trips(self) -> None:
        """Write the trips of this run, each a while after it."""
        while self._trips:
            trip = self._trips[0]
            await asyncio.sleep(max(0.0, trip.time_s + self._after_s - self._clock()))
            if problem := await self._write(trip, _PATIENCE_S):
                self._report(Severity.ALARM, f"{_UNWRITTEN}: {problem}")

    async def finish(self, timeout_s: float) -> None:
        """Write the trips that are not written yet; `run` must have ended.

        What a record is made of is kept first: where the time is short, the next start makes it.

        Args:
            timeout_s: Longest wait for the disk; there is no time for a figure.
        """
        end_s = self._clock() + timeout_s
        left = {trip for trip in tuple(self._trips) if await self._leave(trip, end_s)}
        while self._trips:
            await self._finish(self._trips[0], end_s, left=self._trips[0] in left)

    async def _leave(self, trip: _Trip, end_s: float) -> bool:
        """Keep what the record of a trip is made of; False where that failed."""
        content = b"".join(self._messages(trip))
        return await self._done_aside(lambda: leave(self._left_path(trip), content), end_s)

    async def _finish(self, trip: _Trip, end_s: float, *, left: bool) -> None:
        """Write one trip, or leave it to the next start."""
        problem = await self._write(trip, max(0.0, end_s - self._clock()), NO_FIGURE)
        if problem is None:
            await self._done_aside(lambda: self._left_path(trip).unlink(missing_ok=True), end_s)
        elif left:
            later = "the record of the trip is written at the next start"
            self._report(Severity.WARNING, f"{later}: {problem}")
        else:
            self._report(Severity.ALARM, f"{_UNWRITTEN}: {problem}")

    def _left_path(self, trip: _Trip) -> Path:
        return left_path(Path(self._header.sessions), self._header.info, trip.number)

    async def _write_left(self) -> None:
        """Write the trips for which an earlier run had no time.

        Those of this run go first: what their records are made of is forgotten.
        """
        sessions, drive = Path(self._header.sessions), self._header.info.drive
        found: list[tuple[Path, int]] = []
        with contextlib.suppress(OSError):  # they stay for another start
            await self._aside(lambda: remove_unfinished(sessions, drive))
            found = await self._aside(lambda: left_trips(sessions, drive))
        for path, number in found:
            await self._write_trips()
            try:
                async with asyncio.timeout(_PATIENCE_S):
                    problem = await self._write_one_left(path, number)
            except OSError as error:
                problem = reason_of(error)
            except TimeoutError:
                problem = f"it took longer than {_PATIENCE_S:.3g} s"
            if problem:
                self._report(Severity.WARNING, f"{path} is left as it is: {problem}")

    async def _write_one_left(self, path: Path, number: int) -> str | None:
        try:
            messages = await self._aside(lambda: read_left(path))
            problem = await self._have_written(number, [messages], lambda: None, NO_FIGURE)
        except DamagedTripError as damage:
            kept = await self._aside(lambda: set_aside(path))
            detail = f"{kept} was not written as the record of a trip: {damage}"
            self._report(Severity.WARNING, detail)
            return None
        if problem is None:
            await self._aside(path.unlink)
        return problem

    async def _write(self, trip: _Trip, timeout_s: float, *words: str) -> str | None:
        """Write one trip, which stays to be written where this is cancelled before its end.

        Returns:
            Why it is not written, None where it is.
        """
        messages = self._messages(trip)
        problem: str | None
        try:
            async with asyncio.timeout(timeout_s):
                problem = await self._have_written(
                    trip.number, messages, lambda: self._done(trip), *words
                )
        except TimeoutError:
            problem = f"it took longer than {timeout_s:.3g} s" if timeout_s else "no time was left"
        except OSError as error:
            problem = str(error)
        return problem if self._done(trip) else None

    async def _have_written(
        self, number: int, messages: Iterable[bytes], heard: Callable[[], object], *words: str
    ) -> str | None:
        """Run the process that writes; why it failed.

        Raises:
            DamagedTripError: The messages make no record.
            OSError: The process cannot be started.
        """
        sessions = Path(self._header.sessions)
        writer = await WriterProcess.start(sessions, _MODULE, str(number), *words)
        try:
            for message in messages:
                writer.send(message)
            writer.hang_up()
            async for news in writer.news():
                heard()
                if news.damaged:
                    raise DamagedTripError(news.detail)
                self._report(Severity(news.severity), news.detail)
            return await writer.ended()
        finally:
            await writer.kill()

    def _messages(self, trip: _Trip) -> Iterator[bytes]:
        """Yield what the process that writes a trip reads."""
        yield framed(msgspec.structs.replace(self._header, directory=self.directory))
        begin_s, end_s = trip.time_s - _BEFORE_S, trip.time_s + self._after_s
        for time_s, batch in self._kept:
            if begin_s <= time_s <= end_s:
                yield framed(batch)

    async def _done_aside(self, call: Callable[[], object], end_s: float) -> bool:
        """Do something on the disk; False where that failed, or the disk takes too long."""
        wait_s = end_s - self._clock()
        if wait_s <= 0.0:
            return False
        try:
            await asyncio.wait_for(self._aside(call), wait_s)
        except (OSError, TimeoutError):
            return False
        return True

    async def _aside(self, call: Callable[[], Result]) -> Result:
        """Read or write in a thread, which a disk may hold up.

        Raises:
            OSError: The disk refuses, or no further thread can be started.
        """

        def run() -> Result:
            self._start_thread()
            return call()

        try:
            thread = in_thread(run, "black-box")
        except RuntimeError as problem:
            raise OSError(errno.EAGAIN, str(problem)) from problem
        return await asyncio.wrap_future(thread)

    def _done(self, trip: _Trip) -> bool:
        """Take a trip off those to be written; False where it is not among them."""
        if trip not in self._trips:
            return False
        self._trips.remove(trip)
        return True
