"""The record of a trip: a small session with the time around it."""

from __future__ import annotations

import bisect
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pyarrow as pa

from adaptdrive.recording.memory import TRIP
from adaptdrive.recording.parquet import write_parquet
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.records import EventRow
from adaptdrive.recording.segments import Segment, parquet_path, segments
from adaptdrive.recording.session import (
    NOTES,
    TABLES,
    TICKS,
    TRIP_PREFIX,
    Dropped,
    Ending,
    time_in_name,
    unfinished_folder,
    write_facts,
)
from adaptdrive.recording.tick_times import Counted
from adaptdrive.runtime.reports import MONOTONIC

TEXT_FILE = "trip.txt"
_BEFORE_S = 60.0
"""Time before a trip that its record begins."""


def write_trips(directory: Path, due_s: float, after_s: float) -> list[Path]:
    """Write the record of each trip of a session that has none yet.

    Args:
        directory: Directory of the session.
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
    recent = {table: segments(directory, session.info, table)[-2:] for table in (*TABLES, *NOTES)}
    begin_s = _first_time_s(recent[TICKS])
    return [
        _write(session, recent, trip, path, after_s)
        for trip, path in missing
        if trip.monotonic_s >= begin_s
    ]


def _path(directory: Path, trip: EventRow) -> Path:
    return directory / f"{TRIP_PREFIX}{time_in_name(trip.time)}-{trip.number}"


def _first_time_s(recent: list[Segment]) -> float:
    """Return the time of the first tick that is looked at; 0 without one."""
    for segment in recent:
        for batch in segment.batches([MONOTONIC]):
            return float(batch.column(MONOTONIC)[0].as_py())
    return 0.0


def _write(
    session: Session,
    recent: dict[str, list[Segment]],
    trip: EventRow,
    path: Path,
    after_s: float,
) -> Path:
    begin_s, end_s = trip.monotonic_s - _BEFORE_S, trip.monotonic_s + after_s
    with unfinished_folder(session.path / f".{path.name}") as unfinished:
        count = Counted()
        for table, found in recent.items():
            rows = _between(found, begin_s, end_s)
            write_parquet(parquet_path(unfinished, table, 1), count.taken(table, rows))
        events = [one for one in session.events if begin_s <= one.monotonic_s <= end_s]
        info = msgspec.structs.replace(
            session.info,
            ended=Ending.ORDERLY,
            dropped=Dropped(),
            segments=1,
            rows=count.rows,
            histograms=count.histograms,
            first_sequence=count.first_sequence,
            losses=(),
            log="",
        )
        write_facts(unfinished, info, session.config_text)
        (unfinished / TEXT_FILE).write_text(_text(info.drive, trip, events), encoding="utf-8")
        return unfinished.rename(path)


def _between(found: list[Segment], begin_s: float, end_s: float) -> Iterator[pa.RecordBatch]:
    """Yield the rows of some segments within a time."""
    for segment in found:
        for batch in segment.batches():
            times_s = batch.column(MONOTONIC).to_pylist()
            first, last = bisect.bisect_left(times_s, begin_s), bisect.bisect_right(times_s, end_s)
            if first < last:
                yield batch.slice(first, last - first)


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
