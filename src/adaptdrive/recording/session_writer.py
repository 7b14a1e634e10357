"""The files of one session while it is written."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import pyarrow as pa

from adaptdrive.errors import RecordingError
from adaptdrive.recording import reserve
from adaptdrive.recording.batches import Batch, Header
from adaptdrive.recording.event_log import EventLog
from adaptdrive.recording.housekeeping import Housekeeper
from adaptdrive.recording.repair import repair
from adaptdrive.recording.resume import Written, after, find_written
from adaptdrive.recording.retention import prune
from adaptdrive.recording.segments import segments, stream_path
from adaptdrive.recording.session import (
    EVENTS_FILE,
    INFO_FILE,
    SENSORS,
    SLOW,
    TICKS,
    Dropped,
    Ending,
    NewSession,
    SessionInfo,
    SessionLock,
    create_session,
    read_info,
    write_facts,
    write_info,
)
from adaptdrive.recording.streams import StreamWriter
from adaptdrive.recording.tables import (
    rows_batch,
    sensors_schema,
    slow_schema,
    ticks_batch,
    ticks_schema,
)
from adaptdrive.runtime.reports import Severity

Report = Callable[[Severity, str], None]


class SessionWriter:
    """Writes one session, in segments.

    Attributes:
        directory: Directory of the session.
        segment: Number of the segment in progress.
    """

    def __init__(
        self,
        header: Header,
        report: Report,
        housekeeper: Housekeeper,
        held: SessionLock | None = None,
    ) -> None:
        """Make the session, or go on with it after an interruption.

        Args:
            header: The session; `directory` is empty for a new one.
            report: Reports an event.
            housekeeper: Closes segments, repairs and prunes sessions.
            held: The lock of the session that is gone on with, None where nobody holds it.

        Raises:
            OSError: It cannot be written.
            RecordingError: Another process writes it, or it cannot be read.
        """
        self._header = header
        self._report = report
        self._housekeeper = housekeeper
        self._schemas = {
            TICKS: ticks_schema(header.info.output_unit),
            SLOW: slow_schema(header.info.output_unit),
            SENSORS: sensors_schema(header.sensors),
        }
        self._streams: dict[str, StreamWriter] = {}
        self._events: EventLog | None = None
        self._syncing = threading.Event()
        self._sync_failed = False
        self._began_s = time.monotonic()
        goes_on = bool(header.directory) and Path(header.directory).is_dir()
        self.directory = Path(header.directory) if goes_on else self._made()
        claim = held or SessionLock.on(self.directory)
        if claim is None:
            raise RecordingError(self.directory, "another process writes this session")
        self._claim = claim
        try:
            self._info, self._written = self._known()
        except BaseException:
            if claim is not held:
                claim.release()
            raise
        self.segment = self._written.segment + 1
        if not goes_on:
            housekeeper.submit(self._repair)
            housekeeper.submit(self._prune)

    def write(self, batch: Batch) -> None:
        """Put one batch on disk, events first: they are few and matter most.

        Raises:
            OSError: It cannot be written, or a file of the session was removed from its place:
                one that is still open would take what nobody can read.
        """
        self._require_files()
        if time.monotonic() - self._began_s >= self._header.segment_s:
            self._begin_segment()
        if batch.events or batch.commands:
            self._event_log().append(batch.events, batch.commands)
            self._sync_events()
        offset_s = batch.utc_offset_s
        if batch.tick_rows:
            schema = self._schemas[TICKS]
            self._append(TICKS, ticks_batch(batch.ticks, batch.tick_rows, schema, offset_s))
        if batch.slow:
            self._append(SLOW, rows_batch(batch.slow, self._schemas[SLOW], offset_s))
        if batch.sensors:
            self._append(SENSORS, rows_batch(batch.sensors, self._schemas[SENSORS], offset_s))

    def close(self, ending: Ending, dropped: Dropped) -> None:
        """Close everything; the housekeeper then turns the last streams into Parquet."""
        self._close_streams()
        self._info = msgspec.structs.replace(
            self._info, ended=ending, dropped=dropped, logged=self._rows_logged()
        )
        self._write_info()
        if self._events is not None:
            self._events.close()
            self._events = None
        self._close_segments()
        self._housekeeper.submit(self._claim.release)

    def abandon(self) -> None:
        """Leave everything as it is, to be gone on with later."""
        self.interrupt().release()

    def interrupt(self) -> SessionLock:
        """Do the same, and return the lock of the session, which is still held."""
        for stream in self._streams.values():
            stream.abandon()
        if self._events is not None:
            self._events.abandon()
        return self._claim

    def _require_files(self) -> None:
        (self.directory / INFO_FILE).stat()
        for stream in self._streams.values():
            stream.path.stat()
        if self._events is not None:
            self._events.path.stat()

    def _made(self) -> Path:
        sessions = Path(self._header.sessions)
        sessions.mkdir(parents=True, exist_ok=True)
        reserve.set_aside(sessions)
        return create_session(NewSession(sessions, self._header.info, self._header.config_text))

    def _known(self) -> tuple[SessionInfo, Written]:
        """Facts and contents of the session so far."""
        if not (self.directory / INFO_FILE).exists():
            write_facts(self.directory, self._header.info, self._header.config_text)
        info = read_info(self.directory)
        written = find_written(self.directory, info)
        return msgspec.structs.replace(info, ended=Ending.OPEN), written

    def _append(self, table: str, batch: pa.RecordBatch) -> None:
        """Append what is not on disk yet."""
        new = after(batch, table, self._written.last)
        if new.num_rows:
            if table not in self._streams:
                path = stream_path(self.directory, table, self.segment)
                self._streams[table] = StreamWriter(path, self._schemas[table])
            self._streams[table].write(new)
            self._written.count(table, new)

    def _event_log(self) -> EventLog:
        if self._events is None:
            self._events = EventLog(self.directory / EVENTS_FILE)
        return self._events

    def _rows_logged(self) -> int:
        """Return the number of events and commands in the log, 0 where there is none."""
        if self._events is None and not (self.directory / EVENTS_FILE).exists():
            return 0
        return self._event_log().rows

    def _sync_events(self) -> None:
        """Have the disk keep the events, without waiting for it."""
        if not self._syncing.is_set():
            self._syncing.set()
            self._housekeeper.submit(self._sync_event_log)

    def _sync_event_log(self) -> None:
        self._syncing.clear()
        if (events := self._events) is None:
            return
        try:
            events.sync()
        except OSError:
            # the report of a failure is an event too, which must not cause the next report
            if not self._sync_failed:
                self._sync_failed = True
                raise

    def _begin_segment(self) -> None:
        """Close the segment in progress; the session's facts then include it."""
        reserve.set_aside(self.directory.parent)
        self._close_streams()
        self._write_info()
        self._close_segments()
        self._housekeeper.submit(self._prune)
        self.segment += 1
        self._began_s = time.monotonic()

    def _close_streams(self) -> None:
        for stream in self._streams.values():
            stream.close()
        self._streams = {}

    def _close_segments(self) -> None:
        for segment in segments(self.directory):
            if not segment.closed:
                self._housekeeper.submit(segment.close)

    def _write_info(self) -> None:
        self._info = msgspec.structs.replace(
            self._info,
            histograms=self._written.times.histograms,
            rows=dict(self._written.rows),
            segments=self.segment,
        )
        try:
            write_info(self.directory, self._info)
        except OSError as problem:
            if not reserve.is_full(problem):
                raise
            reserve.release(self.directory.parent)
            write_info(self.directory, self._info)

    def _repair(self) -> None:
        ending = self._housekeeper.ending.is_set
        for sentence in repair(self.directory.parent, self.directory, self._info.drive, ending):
            self._report(Severity.WARNING, sentence)

    def _prune(self) -> None:
        keep = self._header.keep
        for sentence in prune(self.directory.parent, keep, datetime.now(UTC), self.directory):
            self._report(Severity.INFO, sentence)
