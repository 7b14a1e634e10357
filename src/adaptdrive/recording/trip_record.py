"""The record of a trip: a small session with the time around it."""

from __future__ import annotations

import bisect
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from adaptdrive.recording.memory import TRIP
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.records import EventRow
from adaptdrive.recording.segments import Batches, Segment, segments, write_segment
from adaptdrive.recording.session import (
    NOTES,
    TABLES,
    TRIP_PREFIX,
    Ending,
    SessionInfo,
    TableName,
    time_in_name,
    unfinished_folder,
    write_facts,
)
from adaptdrive.recording.tables import table_schema
from adaptdrive.runtime.reports import MONOTONIC

TEXT_FILE = "trip.txt"
_BEFORE_S = 60.0
"""Time before a trip that its record begins."""


def write_trips(directory: Path, info: SessionInfo, due_s: float, after_s: float) -> list[Path]:
    """Write the record of each trip of a session that has none yet.

    Args:
        directory: Directory of the session.
        info: What was known about it before its first tick.
        due_s: Time of the last trip whose record is due, monotonic.
        after_s: Time after a trip that belongs to its record.

    Returns:
        Folders of the records.

    Raises:
        RecordingError: The session is damaged.
        OSError: A record cannot be written.
    """
    session = read_session(directory)
    trips = [one for one in session.events if one.kind == TRIP and one.monotonic_s <= due_s]
    missing = [(one, path) for one in trips if not (path := _path(directory, one)).exists()]
    info = msgspec.structs.replace(info, ended=Ending.ORDERLY, log="")
    recent = {table: segments(directory, session.info, table)[-2:] for table in (*TABLES, *NOTES)}
    session, begin_s = replace(session, info=info), _first(recent[TableName.TICKS], MONOTONIC)
    return [
        _write(session, recent, trip, path, after_s)
        for trip, path in missing
        if trip.monotonic_s >= begin_s
    ]


def _path(directory: Path, trip: EventRow) -> Path:
    return directory / f"{TRIP_PREFIX}{time_in_name(trip.time)}-{trip.number}"


def _first(found: list[Segment], column: str) -> Any:  # noqa: ANN401 - of the column
    """Return the first value of a column of ticks; 0 without one."""
    schema = pa.schema([table_schema(TableName.TICKS).field(column)])
    values = (batch.column(column)[0].as_py() for one in found for batch in one.rows(schema))
    return next(values, 0)


def _write(
    session: Session,
    recent: dict[str, list[Segment]],
    trip: EventRow,
    path: Path,
    after_s: float,
) -> Path:
    begin_s, end_s = trip.monotonic_s - _BEFORE_S, trip.monotonic_s + after_s

    def rows_of(table: str) -> Batches:
        schema = table_schema(table, session.info)
        for batch in chain.from_iterable(segment.rows(schema) for segment in recent[table]):
            times_s = batch.column(MONOTONIC).to_pylist()
            first, last = bisect.bisect_left(times_s, begin_s), bisect.bisect_right(times_s, end_s)
            if first < last:
                yield batch.slice(first, last - first)

    with unfinished_folder(session.path / f".{path.name}") as unfinished:
        info = write_segment(unfinished, session.info, 1, rows_of)
        first = _first(segments(unfinished, info, TableName.TICKS), "sequence")
        info = msgspec.structs.replace(info, first_sequence=first)
        write_facts(unfinished, info, session.config_text)
        events = [one for one in session.events if begin_s <= one.monotonic_s <= end_s]
        (unfinished / TEXT_FILE).write_text(_text(info.drive, trip, events), encoding="utf-8")
        return unfinished.rename(path)


def _text(drive: str, trip: EventRow, events: list[EventRow]) -> str:
    lines = [
        trip.detail,
        "",
        f"drive {drive}, {trip.time:%Y-%m-%dT%H:%M:%S.%f}Z, tick {trip.tick}",
        "",
        "events before and after:",
        *(f"{one.time:%H:%M:%S.%f} {one.severity:<7} {one.kind}: {one.detail}" for one in events),
    ]
    return "\n".join(lines) + "\n"
