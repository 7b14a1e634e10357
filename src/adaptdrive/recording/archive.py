"""The archive: a fold from the journal of a drive to the folders of its sessions and trips.

It gives the same result however often it is run: a Parquet file and `session.json` appear whole,
and a file of the log is removed when all of it is in them. A full disk, a kill or a damaged part
of the log therefore needs no repair but another run.
"""

import bisect
import fcntl
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from itertools import chain, groupby
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import pyarrow as pa

from adaptdrive.recording import journal_files, reader, records, segments, session, tables, writer
from adaptdrive.runtime.reports import MONOTONIC, Severity
from adaptdrive.safety.trips import ADVICES, TripKind, kind_of, remedy
from adaptdrive.util.errors import AdaptdriveError, RecordingError

# The record of a trip: a small session with the time around it.

TEXT_FILE = "trip.txt"
_BEFORE_S = 60.0
"""Time before a trip that its record begins."""


def _write_trips(
    directory: Path, header: records.Header, due_s: float, after_s: float
) -> list[Path]:
    """Write the record of each trip of a session that has none yet, up to one that is due."""
    found = segments.segments(directory, session.read_info(directory))
    recent = {table: [one for one in found if one.table == table][-2:] for table in segments.KINDS}
    events = segments.read_notes(found, session.TableName.EVENTS, [])
    info = msgspec.structs.replace(header.info, ended=session.Ending.ORDERLY, log="")
    header = msgspec.structs.replace(header, info=info)
    begin_s, written = _first(recent[session.TableName.TICKS], MONOTONIC), []
    for trip in events:
        name = f"{session.TRIP_PREFIX}{session.time_in_name(trip.time)}-{trip.number}"
        is_due = trip.kind == journal_files.TRIP and begin_s <= trip.monotonic_s <= due_s
        if is_due and not (directory / name).exists():
            around_s = trip.monotonic_s - _BEFORE_S, trip.monotonic_s + after_s
            near = [one for one in events if around_s[0] <= one.monotonic_s <= around_s[1]]
            text = _text(info.drive, trip, near)
            written.append(_write(directory / name, header, recent, around_s, text))
    return written


def _first(found: list[segments.Segment], column: str) -> Any:  # noqa: ANN401 - of the column
    """Return the first value of a column of ticks; 0 without one."""
    schema = pa.schema([tables.table_schema(session.TableName.TICKS).field(column)])
    values = (batch.column(column)[0].as_py() for one in found for batch in one.rows(schema))
    return next(values, 0)


def _write(
    path: Path,
    header: records.Header,
    recent: dict[str, list[segments.Segment]],
    around_s: tuple[float, float],
    text: str,
) -> Path:
    def rows_of(table: str) -> segments.Batches:
        schema = tables.table_schema(table, header.info)
        for batch in chain.from_iterable(segment.rows(schema) for segment in recent[table]):
            times_s = batch.column(MONOTONIC).to_pylist()
            first = bisect.bisect_left(times_s, around_s[0])
            last = bisect.bisect_right(times_s, around_s[1])
            if first < last:
                yield batch.slice(first, last - first)

    with session.unfinished_folder(path.with_name(f".{path.name}")) as unfinished:
        info = segments.write_segment(unfinished, header.info, 1, rows_of)
        first = _first(segments.segments(unfinished, info, session.TableName.TICKS), "sequence")
        info = msgspec.structs.replace(info, first_sequence=first)
        session.write_facts(unfinished, info, header.config_text)
        (unfinished / TEXT_FILE).write_text(text, encoding="utf-8")
        return unfinished.rename(path)


def _text(drive: str, trip: records.EventRow, events: list[records.EventRow]) -> str:
    lines = [
        trip.detail,
        "",
        f"drive {drive}, {trip.time:%Y-%m-%dT%H:%M:%S.%f}Z, tick {trip.tick}",
        *_advice(kind_of(trip.trip_kind)),
        "",
        "events before and after:",
        *(f"{one.time:%H:%M:%S.%f} {one.severity:<7} {one.kind}: {one.detail}" for one in events),
    ]
    return "\n".join(lines) + "\n"


def _advice(kind: TripKind | None) -> list[str]:
    """Return the kind of a trip, its remedy, and the page of the manual that says more."""
    if kind is None:
        return []
    return [f"kind: {kind}", f"remedy: {remedy(kind)}", f"page: {ADVICES[kind].page}"]


# The archive: a fold from the log of a drive to the folders of its sessions.

T = TypeVar("T")
Report = Callable[[Severity, str], None]

ERRORS = (AdaptdriveError, OSError, pa.ArrowException)
"""Errors that a disk or damaged files can cause."""


@dataclass(frozen=True, slots=True)
class _Logged:
    """Records of a session in the log.

    Attributes:
        header: The session.
        files: Files of it, in their order.
        newest: Whether no other session began later.
        open: Segment that is still written, 0 for none.
    """

    header: records.Header
    files: tuple[journal_files.LogFile, ...]
    newest: bool
    open: int

    @property
    def folder(self) -> Path:
        """Folder of the log."""
        return self.files[0].path.parent


def archive(folder: Path, now_s: float, after_s: float, report: Report) -> list[Path]:
    """Write what the log has into the folders of its sessions.

    A session that cannot be written stays in the log and keeps no other from being written.

    Args:
        folder: Folder of the log.
        now_s: Present time, monotonic.
        after_s: Time after a trip that belongs to its record.
        report: Reports an event.

    Returns:
        Folders of the records of trips that were written.

    Raises:
        RecordingError: Something of the log could not be written.
        OSError: Another archiver cannot be kept out.
    """
    written: list[Path] = []
    failures: list[str] = []
    if not folder.exists():  # a daemon that begins may not have made it yet
        return written
    with _alone(folder):
        # listed once: what the daemon begins meanwhile is for the next run, and stays
        files, live = journal_files.log_files(folder), journal_files.is_live(folder)
        for started, group in groupby(files, key=lambda file: file.session):
            of_session, newest = tuple(group), started == files[-1].session
            try:
                begin = next(filter(None, (file.begin() for file in of_session)), None)
                if begin is None:
                    _put_aside(of_session, report)
                    continue
                open_part = files[-1].part if live and newest else 0
                logged = _Logged(begin.header, of_session, newest, open_part)
                written += _archive(logged, now_s, after_s, report)
            except ERRORS as problem:
                failures.append(f"session {started} stays in the log: {problem}")
        if failures:
            raise RecordingError(folder, "; ".join(failures))
        _remove_archived(files, live=live)
    return written


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other archivers out."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _put_aside(files: Sequence[journal_files.LogFile], report: Report) -> None:
    """Rename files without a first record that can be read; those that took no record go."""
    for file in files:
        if not file.path.stat().st_size:
            file.path.unlink()
            continue
        kept = file.path.rename(file.path.with_name(f"damaged-{file.path.name}"))
        report(Severity.WARNING, f"{kept} is of no session that can be told: it is kept")


def _archive(logged: _Logged, now_s: float, after_s: float, report: Report) -> list[Path]:
    directory = _directory(logged)
    if directory is None:
        return []
    due_s = now_s - after_s if logged.open else math.inf
    trips = _with_reserve(
        logged.folder, lambda: _write_trips(directory, logged.header, due_s, after_s)
    )
    info = session.read_info(directory)
    for part, files in groupby(logged.files, key=lambda file: file.part):
        if info.segments < part != logged.open:
            write = partial(close_segment, directory, logged.header, info, part, tuple(files))
            info = _with_reserve(logged.folder, write)
    if not logged.open and info.ended is session.Ending.OPEN:
        _with_reserve(logged.folder, lambda: _end(directory, info, logged, report))
    if logged.newest:
        keep = logged.header.keep
        for sentence in segments.prune(directory.parent, keep, datetime.now(UTC), directory):
            report(Severity.INFO, sentence)
    return trips


def _with_reserve(folder: Path, write: Callable[[], T]) -> T:
    try:
        return write()
    except ERRORS:
        # whatever it was: the reserve is what can be done about it
        writer.release(folder)
        return write()


def _directory(logged: _Logged) -> Path | None:
    """Return the folder of a session; one that was removed is made again for its rows."""
    header = logged.header
    if not header.sessions:
        return None
    sessions = logged.folder.parent / header.sessions
    found = session.session_of(sessions, header.info)
    if found is None and journal_files.last_of(logged.files, *records.ROW_KINDS):
        return session.create_session(sessions, header.info, header.config_text)
    return found


def close_segment(
    directory: Path,
    header: records.Header,
    info: session.SessionInfo,
    part: int,
    files: Sequence[journal_files.LogFile],
) -> session.SessionInfo:
    """Write one segment; `session.json` is last, and states that it is closed.

    Args:
        directory: Directory of the session.
        header: The session.
        info: Its facts.
        part: Number of the segment.
        files: Files of the log that hold it.

    Returns:
        Its facts now.

    Raises:
        RecordingError: The log cannot be read.
        OSError: The segment cannot be written.
    """
    losses: list[str] = []

    def rows_of(table: str) -> Iterator[pa.RecordBatch]:
        return segments.logged_batches(
            files, table, tables.table_schema(table, header.info), losses
        )

    info = segments.write_segment(directory, info, part, rows_of)
    last = journal_files.last_of(files, records.Kind.DROPPED)
    dropped = segments.content_of(last, session.Dropped, losses) if last else None
    losses = [*info.losses, *dict.fromkeys(losses)]
    info = msgspec.structs.replace(info, dropped=dropped or info.dropped, losses=tuple(losses))
    session.write_info(directory, info)
    return info


def _end(directory: Path, info: session.SessionInfo, logged: _Logged, report: Report) -> None:
    """Write how a session ended, and report what it lacks."""
    closed = journal_files.last_of(logged.files, records.Kind.END) is not None
    ending = session.Ending.ORDERLY if closed else session.Ending.CUT
    session.write_info(directory, msgspec.structs.replace(info, ended=ending))
    if ending is session.Ending.CUT:
        last = reader.read_session(directory).last_tick
        until = f"its last tick is of {last:%Y-%m-%dT%H:%M:%S.%f}Z" if last else "it has no ticks"
        detail = f"session {directory.name} ended without its close, the daemon was killed: {until}"
        report(Severity.WARNING, detail)
    for loss in info.losses:
        report(Severity.WARNING, f"session {directory.name}: {loss}")


def _remove_archived(files: Sequence[journal_files.LogFile], *, live: bool) -> None:
    """Remove the files before the last one that says what they have left."""
    sound = journal_files.since_last_begin(files, [])
    if not sound:
        return
    open_part = (files[-1].session, files[-1].part) if live else None
    with sound[0].path.open("rb") as kept:
        os.fsync(kept.fileno())
    for file in files:
        if file.number < sound[0].number and (file.session, file.part) != open_part:
            file.path.unlink(missing_ok=True)
