"""The archive: a fold from the log of a drive to the folders of its sessions and trips.

It gives the same result however often it is run: Parquet files and `session.json` appear whole, and
a file of the log is removed when all of it is in them. A full disk, a kill or a damaged part of the
log therefore needs no repair but another run.
"""

import bisect
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import ParamSpec, TypeVar

import msgspec
import pyarrow as pa

from adaptdrive.recording import health, log_files, overview, reader, records, segments, session
from adaptdrive.recording.tables import NOTE_ROWS, table_schema, write_parquet
from adaptdrive.runtime.reports import MONOTONIC, Event, Severity
from adaptdrive.runtime.timebase import BINS, bin_of
from adaptdrive.safety.trips import ADVICES, kind_of, remedy
from adaptdrive.util.errors import AdaptdriveError, RecordingError
from adaptdrive.util.files import alone
from adaptdrive.util.trends import HealthReport

T = TypeVar("T")
P = ParamSpec("P")

# Segments: rows of all tables, counted, in Parquet files.

_TIMES = ("lateness_us", "turnaround_us", "tick_us")


def write_segment(
    directory: Path, info: session.SessionInfo, part: int, batches: segments.Batches
) -> session.SessionInfo:
    """Write a segment of each table, and count its rows and the times of its ticks.

    Args:
        directory: Directory of the session.
        info: Its facts.
        part: Number of the segment.
        batches: Its rows.

    Returns:
        Its facts with the segment.

    Raises:
        RecordingError: Its rows cannot be read.
        OSError: It cannot be written.
    """
    rows = dict(info.rows)
    times = {name: list(info.histograms.get(name, [0] * BINS)) for name in _TIMES}

    def counted() -> segments.Batches:
        for table, batch in batches:
            rows[table] = rows.get(table, 0) + batch.num_rows
            for name, counts in times.items() if table == session.TableName.TICKS else ():
                for time_us in batch.column(name).to_pylist():
                    if not math.isnan(time_us):  # a stand-in tick has no turnaround
                        counts[bin_of(time_us)] += 1
            yield table, batch

    write_parquet(lambda table: segments.parquet_path(directory, table, part), counted())
    histograms = {name: tuple(counts) for name, counts in times.items()}
    return msgspec.structs.replace(info, segments=part, rows=rows, histograms=histograms)


def _schemas(info: session.SessionInfo) -> dict[str, pa.Schema]:
    return {table: table_schema(table, info) for table in segments.KINDS}


# The record of a trip: a small session with the time around it.

_BEFORE_S = 60.0
"""Time before a trip that its record begins."""


def _write_trips(
    directory: Path, header: records.Header, due_s: float, after_s: float
) -> list[Path]:
    """Write the record of each trip of a session that has none yet, up to one that is due."""
    noted, recent = (
        _last_two(segments.segments(directory, session.read_info(directory), wanted))
        for wanted in (NOTE_ROWS, segments.KINDS)
    )
    events, _ = segments.read_notes(noted, [])
    info = msgspec.structs.replace(header.info, ended=session.Ending.ORDERLY, log="")
    written = []
    for trip in events:
        name = f"{session.TRIP_PREFIX}{session.time_in_name(trip.time)}-{trip.number}"
        is_due = trip.kind == log_files.TRIP and trip.monotonic_s <= due_s
        if is_due and not (directory / name).exists():
            around_s = trip.monotonic_s - _BEFORE_S, trip.monotonic_s + after_s
            near = [one for one in events if around_s[0] <= one.monotonic_s <= around_s[1]]
            with session.unfinished_folder(directory / f".{name}") as folder:
                kept = _write_rows(folder, info, recent, around_s)
                session.write_facts(folder, kept, header.config_text)
                (folder / session.TRIP_TEXT).write_text(
                    _text(info.drive, trip, near), encoding="utf-8"
                )
                written.append(folder.rename(directory / name))
    return written


def _last_two(found: Sequence[segments.Segment]) -> list[segments.Segment]:
    return [one for one in found if one.number >= found[-1].number - 1]


def _write_rows(
    folder: Path,
    info: session.SessionInfo,
    recent: Sequence[segments.Segment],
    around_s: tuple[float, float],
) -> session.SessionInfo:
    """Write the rows of a time; return the facts about them."""
    firsts: list[int] = []

    def near() -> segments.Batches:
        for table, batch in (pair for one in recent for pair in one.rows(_schemas(info))):
            times_s = batch.column(MONOTONIC).to_pylist()
            first = bisect.bisect_left(times_s, around_s[0])
            last = bisect.bisect_right(times_s, around_s[1])
            if first < last:
                if table == session.TableName.TICKS:
                    firsts.append(batch.column("sequence")[first].as_py())
                yield table, batch.slice(first, last - first)

    info = write_segment(folder, info, 1, near())
    return msgspec.structs.replace(info, first_sequence=min(firsts, default=0))


def _text(drive: str, trip: records.EventRow, events: list[records.EventRow]) -> str:
    """Return a trip with its kind, remedy and page of the manual, and the events near it."""
    advice, kind = [], kind_of(trip.trip_kind)
    if kind is not None:
        advice = [f"kind: {kind}", f"remedy: {remedy(kind)}", f"page: {ADVICES[kind].page}"]
    lines = [
        trip.detail,
        "",
        f"drive {drive}, {trip.time:%Y-%m-%dT%H:%M:%S.%f}Z, tick {trip.tick}",
        *advice,
        "",
        "events before and after:",
        *(f"{one.time:%H:%M:%S.%f} {one.severity:<7} {one.kind}: {one.detail}" for one in events),
    ]
    return "\n".join(lines) + "\n"


# The archive: a fold from the log of a drive to the folders of its sessions.

Report = Callable[[Severity, str], None]
Publish = Callable[[Event | HealthReport], None]

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
    files: tuple[log_files.LogFile, ...]
    newest: bool
    open: int

    @property
    def folder(self) -> Path:
        """Folder of the log."""
        return self.files[0].path.parent

    def with_reserve(self, write: Callable[P, T], *what: P.args, **named: P.kwargs) -> T:
        """Write something, on a full disk into the reserve."""
        try:
            return write(*what, **named)
        except ERRORS:
            # whatever it was: the reserve is what can be done about it
            log_files.release(self.folder)
            return write(*what, **named)


def archive(
    folder: Path,
    now_s: float,
    after_s: float,
    report: Report,
    publish: Publish = lambda _: None,
) -> list[Path]:
    """Write what the log has into the folders of its sessions.

    A session that cannot be written stays in the log and keeps no other from being written.

    Args:
        folder: Folder of the log.
        now_s: Present time, monotonic.
        after_s: Time after a trip that belongs to its record.
        report: Reports an event.
        publish: Takes the health of the load, and events about it.

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
    with alone(folder):
        # listed once: what the daemon begins meanwhile is for the next run, and stays
        files, live = log_files.log_files(folder), log_files.is_live(folder)
        for started, group in groupby(files, key=lambda file: file.session):
            of_session, newest = tuple(group), started == files[-1].session
            try:
                begin = next(filter(None, (file.begin() for file in of_session)), None)
                if begin is None:
                    _put_aside(of_session, report)
                    continue
                open_part = files[-1].part if live and newest else 0
                logged = _Logged(begin.header, of_session, newest, open_part)
                written += _archive(logged, now_s, after_s, report, publish)
            except ERRORS as problem:
                failures.append(f"session {started} stays in the log: {problem}")
        if failures:
            raise RecordingError(folder, "; ".join(failures))
        _remove_archived(files, live=live)
    return written


def _put_aside(files: Sequence[log_files.LogFile], report: Report) -> None:
    """Rename files without a first record that can be read; those that took no record go."""
    for file in files:
        if not file.path.stat().st_size:
            file.path.unlink()
            continue
        kept = file.path.rename(file.path.with_name(f"damaged-{file.path.name}"))
        report(Severity.WARNING, f"{kept} is of no session that can be told: it is kept")


def _archive(
    logged: _Logged, now_s: float, after_s: float, report: Report, publish: Publish
) -> list[Path]:
    directory = _directory(logged)
    if directory is None:
        return []
    due_s = now_s - after_s if logged.open else math.inf
    trips = logged.with_reserve(_write_trips, directory, logged.header, due_s, after_s)
    info = session.read_info(directory)
    for part, files in groupby(logged.files, key=lambda file: file.part):
        if info.segments < part != logged.open:
            known = len(info.losses)
            info = logged.with_reserve(close_segment, directory, info, part, tuple(files))
            for loss in info.losses[known:]:
                report(Severity.WARNING, f"session {directory.name}: {loss}")
    if not logged.open and info.ended is session.Ending.OPEN:
        logged.with_reserve(_cut, directory, info, report)
    if logged.header.health.loss:
        try:
            logged.with_reserve(_update_health, directory, logged.header.health, publish)
        except (*ERRORS, ArithmeticError, ValueError) as problem:  # the log need not wait for it
            report(Severity.WARNING, f"health of session {directory.name}: {problem}")
    if logged.newest:
        keep = logged.header.keep
        for sentence in segments.prune(directory.parent, keep, datetime.now(UTC), directory):
            report(Severity.INFO, sentence)
    _update_index(directory, report)
    return trips


def _update_index(directory: Path, report: Report) -> None:
    try:
        overview.update_index(directory.parent, {directory.name})
    except ERRORS as problem:  # only pages lack it: the log need not wait
        report(Severity.WARNING, f"session {directory.name} has no overview: {problem}")


def _update_health(directory: Path, settings: records.HealthSettings, publish: Publish) -> None:
    """Add the rows of the health of a load, and publish it."""
    rows, events = health.update(directory, settings)
    for one in (*events, health.report(rows)):
        if one is not None:
            publish(one)


def _directory(logged: _Logged) -> Path | None:
    """Return the folder of a session; one that was removed is made again for its rows."""
    header = logged.header
    if not header.sessions:
        return None
    sessions = logged.folder.parent / header.sessions
    found = session.session_of(sessions, header.info)
    if found is None and log_files.last_of(logged.files, *records.ROW_KINDS):
        return session.create_session(sessions, header.info, header.config_text)
    return found


def close_segment(
    directory: Path, info: session.SessionInfo, part: int, files: Sequence[log_files.LogFile]
) -> session.SessionInfo:
    """Write one segment; `session.json` is last, and states that it is closed.

    Args:
        directory: Directory of the session.
        info: Its facts.
        part: Number of the segment.
        files: Files of the log that hold it, which are read once.

    Returns:
        Its facts now.

    Raises:
        RecordingError: The log cannot be read.
        OSError: The segment cannot be written.
    """
    losses: list[str] = []
    last: dict[records.Kind, records.Record] = {}
    schemas = _schemas(info)
    batches = segments.logged_batches(files, schemas, losses, last)
    info = write_segment(directory, info, part, batches)
    if dropped := last.get(records.Kind.DROPPED):
        found = segments.content_of(dropped, session.Dropped, losses)
        info = msgspec.structs.replace(info, dropped=found or info.dropped)
    if records.Kind.END in last:
        info = msgspec.structs.replace(info, ended=session.Ending.ORDERLY)
    losses = [*info.losses, *dict.fromkeys(losses)]
    info = msgspec.structs.replace(info, losses=tuple(losses))
    session.write_info(directory, info)
    return info


def _cut(directory: Path, info: session.SessionInfo, report: Report) -> None:
    """Write that a session ended without its close, and report it."""
    session.write_info(directory, msgspec.structs.replace(info, ended=session.Ending.CUT))
    last = reader.read_session(directory).last_tick
    until = f"its last tick is of {last:%Y-%m-%dT%H:%M:%S.%f}Z" if last else "it has no ticks"
    detail = f"session {directory.name} ended without its close, the daemon was killed: {until}"
    report(Severity.WARNING, detail)


def _remove_archived(files: Sequence[log_files.LogFile], *, live: bool) -> None:
    """Remove the files before the last one that says what they have left."""
    sound = log_files.since_last_begin(files, [])
    if not sound:
        return
    open_part = (files[-1].session, files[-1].part) if live else None
    with sound[0].path.open("rb") as kept:
        os.fsync(kept.fileno())
    for file in files:
        if file.number < sound[0].number and (file.session, file.part) != open_part:
            file.path.unlink(missing_ok=True)
