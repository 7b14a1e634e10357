"""Segments of a session, and how long they are kept.

Their rows are in Parquet files, and after them in the log only.

Ages follow the wall clock, which may be wrong at the start of a machine. A recorder removes
sessions for their age only while one session, its own included, began at least a day and at most
`keep.days` ago: after the clock has leapt ahead there is none.

A symbolic link to a session, such as one that was moved to another disk, takes no room here: it is
neither counted nor removed.
"""

import math
import os
import re
import shutil
import zlib
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from adaptdrive.recording import log_files, session, tables
from adaptdrive.recording.records import ROW_KINDS, CommandRow, EventRow, Keep, Kind, Record, Ticks
from adaptdrive.recording.session import SessionInfo, TableName
from adaptdrive.runtime.reports import MONOTONIC
from adaptdrive.util.errors import NOT_JSON, RecordingError

Batches = Iterator[tuple[str, pa.RecordBatch]]
"""Rows, each batch with the name of its table."""

_TICKS_AT_ONCE = 5_000
_ROWS_AT_ONCE = 200
"""Rows of a batch: as Python values they take many times their size on disk."""

KINDS: dict[str, tuple[Kind, Any, str]] = {
    TableName.TICKS: (Kind.TICKS, Ticks, "sequence"),
    TableName.SLOW: (Kind.SLOW, list[dict[str, Any]], MONOTONIC),
    TableName.SENSORS: (Kind.SENSORS, list[dict[str, Any]], MONOTONIC),
    TableName.EVENTS: (Kind.EVENT, EventRow, "number"),
    TableName.COMMANDS: (Kind.COMMAND, CommandRow, "number"),
}
"""Kind and contents of the records of each table, and its column that only ever grows."""

_TABLES = {kind: table for table, (kind, _, _) in KINDS.items()}
_NAME = re.compile(rf"({'|'.join(KINDS)})-(\d{{4,}})\.parquet")


@dataclass(frozen=True, slots=True, order=True)
class Segment:
    """Rows of one segment.

    Attributes:
        number: From 1.
        tables: Names of its tables: one in a Parquet file, any in the log.
        directory: Directory of the session.
        logged: Files of the log that hold it; none once there are Parquet files.
    """

    number: int
    tables: tuple[str, ...]
    directory: Path
    logged: tuple[log_files.LogFile, ...] = ()

    @property
    def path(self) -> Path:
        """Parquet file of its first table, not made yet where it is in the log."""
        return parquet_path(self.directory, self.tables[0], self.number)

    def rows(self, schemas: Mapping[str, pa.Schema], losses: list[str] | None = None) -> Batches:
        """Yield its rows; each of its files is read once.

        Args:
            schemas: The columns wanted of each of its tables.
            losses: Takes what of the log cannot be read, in words.

        Raises:
            RecordingError: A file is damaged, or holds another table.
        """
        logged = {}
        for table in self.tables:
            path = parquet_path(self.directory, table, self.number)
            if self.logged and not path.exists():  # perhaps since it was listed
                logged[table] = schemas[table]
            else:
                yield from ((table, one) for one in tables.read_parquet(path, schemas[table]))
        if logged:
            yield from logged_batches(self.logged, logged, [] if losses is None else losses)


def parquet_path(directory: Path, table: str, number: int) -> Path:
    """Return the path of a segment of a table."""
    return directory / f"{table}-{number:04}.parquet"


def segments(
    directory: Path, info: SessionInfo | None, wanted: Collection[str] = tuple(KINDS)
) -> list[Segment]:
    """Return the segments of a session in their order.

    Args:
        directory: Directory of the session.
        info: Its facts; without them only those that are no longer in the log.
        wanted: Names of the tables.

    Raises:
        RecordingError: The folder of the log cannot be read.
    """
    unarchived = log_files.unarchived(directory, info) if info else []
    matches = (_NAME.fullmatch(path.name) for path in directory.iterdir())
    closed = {(int(match[2]), match[1]) for match in matches if match and match[1] in wanted}
    found = [Segment(number, (table,), directory) for number, table in closed]
    for part, files in groupby(unarchived, key=lambda file: file.part):
        if left := tuple(table for table in wanted if (part, table) not in closed):
            found.append(Segment(part, left, directory, tuple(files)))
    return sorted(found)


def read_notes(
    found: Iterable[Segment], damage: list[str] | None = None
) -> tuple[tuple[EventRow, ...], tuple[CommandRow, ...]]:
    """Return the events and the commands in segments.

    Args:
        found: The segments, of these tables.
        damage: Takes what cannot be read, in words; None to refuse that.

    Raises:
        RecordingError: They are damaged.
    """
    notes: dict[str, list[Any]] = {table: [] for table in tables.NOTE_ROWS}
    schemas = {table: tables.table_schema(table) for table in notes}
    for segment in found:
        try:
            for table, batch in segment.rows(schemas):
                notes[table] += _notes(segment, table, batch)
        except RecordingError as problem:
            if damage is None:
                raise
            damage.append(str(problem))
    return tuple(notes[TableName.EVENTS]), tuple(notes[TableName.COMMANDS])


def _notes(segment: Segment, table: str, batch: pa.RecordBatch) -> list[Any]:
    try:
        return [msgspec.convert(row, tables.NOTE_ROWS[table]) for row in batch.to_pylist()]
    except (msgspec.ValidationError, ValueError, OverflowError) as problem:
        raise RecordingError(segment.path, f"damaged {table}: {problem}") from problem


def logged_batches(
    files: Sequence[log_files.LogFile],
    schemas: Mapping[str, pa.Schema],
    losses: list[str],
    last: dict[Kind, Record] | None = None,
) -> Batches:
    """Yield rows in files of the log, which are read once.

    Args:
        files: Files of one segment of a session, in their order.
        schemas: The columns wanted of each table.
        losses: Takes what cannot be read, in words.
        last: Takes the last record of each other kind.

    Raises:
        RecordingError: A file cannot be read at all.
    """
    last = {} if last is None else last
    timed = defaultdict[str, list[tuple[Any, float]]](list)
    count = dict.fromkeys(schemas, 0)
    for record in log_files.records(files, losses):
        table = _TABLES.get(record.kind, "")
        if table not in schemas:
            last[record.kind] = record
            continue
        found = content_of(record, KINDS[table][1], losses)
        if found is None:
            continue
        if table in tables.NOTE_ROWS:
            found = [msgspec.structs.asdict(found)]
        timed[table].append((found, record.wall_s - record.monotonic_s))
        count[table] += found.rows if isinstance(found, Ticks) else len(found)
        if count[table] >= (_TICKS_AT_ONCE if table == TableName.TICKS else _ROWS_AT_ONCE):
            # they are given up before the batch is taken
            made, count[table] = _made(timed.pop(table), table, schemas[table], losses), 0
            yield from made
    for table, rest in timed.items():
        yield from _made(rest, table, schemas[table], losses) if count[table] else ()


def _made(
    timed: Sequence[tuple[Any, float]], table: str, schema: pa.Schema, losses: list[str]
) -> list[tuple[str, pa.RecordBatch]]:
    """Return a batch, or note that its rows do not fit their table, as those of another version."""
    try:
        return [(table, tables.batch_of(table, timed, schema))]
    except (LookupError, TypeError, ValueError, OverflowError) as problem:
        losses.append(f"rows that make no table: {problem}")
        return []


def content_of(record: Record, kind: type[Any], losses: list[str]) -> Any:  # noqa: ANN401 - of a kind
    """Return what a record holds, None where it cannot be decoded.

    Args:
        record: The record.
        kind: Type of its contents.
        losses: Takes what cannot be read, in words.
    """
    try:
        packed = record.kind in ROW_KINDS
        payload = zlib.decompress(record.payload) if packed else record.payload
        return msgspec.msgpack.decode(payload, type=kind)
    except (zlib.error, *NOT_JSON) as problem:
        losses.append(f"record {record.number}: {problem}")
        return None


# Retention: which sessions and segments go when space is short, or time has passed.

_DAY_S = 86_400.0

_CONFIRMED_DAYS = 1.0
"""Age of the session that confirms the clock: a wrong one is noticed or set within this time."""


def prune(sessions: Path, keep: Keep, now: datetime, current: Path | None = None) -> Iterator[str]:
    """Remove what is too old or too much.

    The oldest sessions go first, then the oldest segments of the session in progress.

    Args:
        sessions: Folder of all sessions.
        keep: How long sessions are kept.
        now: Present time, UTC.
        current: The session in progress, which loses closed segments at most; None where a person
            has asked for the removal.

    Yields:
        A sentence for each removal.

    Raises:
        RecordingError: A session cannot be removed; the others are.
    """
    found = [path for path in session.session_directories(sessions) if not path.is_symlink()]
    sizes = {path: size_of(path) for path in found}
    outdated = _too_old(found, keep, now, by_person=current is None)
    excess = -math.inf if keep.bytes is None else sum(sizes.values()) - keep.bytes
    failed: list[RecordingError] = []
    for directory in (path for path in found if path != current):
        cause = f"it is older than {keep.days:g} days" if directory in outdated else ""
        if excess > 0:
            cause = f"sessions take more than {(keep.bytes or 0) / 1e6:g} MB"
        try:
            removed = bool(cause) and _remove(directory)
        except OSError as problem:
            failed.append(RecordingError(directory, f"the session cannot be removed: {problem}"))
            continue
        if removed:
            excess -= sizes[directory]
            yield f"session {directory.name} removed: {cause}"
    yield from _prune_segments(current, excess) if current else ()
    if failed:
        raise failed[0]


def _prune_segments(directory: Path, excess: float) -> Iterator[str]:
    for segment in segments(directory, None, session.TABLES):
        if excess <= 0:
            return
        path = segment.path
        excess -= path.stat().st_size
        path.unlink()
        yield f"{path.name} of session {directory.name} removed: sessions take too much"


def _remove(directory: Path) -> bool:
    """Remove a session; another drive that shares the folder, or a person, may have done it."""
    # nobody writes a session whose facts cannot be read
    with suppress(RecordingError):
        if log_files.in_progress(directory, session.read_info(directory)):
            return False
    with suppress(FileNotFoundError):
        shutil.rmtree(directory)
        return True
    return False


def _too_old(directories: list[Path], keep: Keep, now: datetime, *, by_person: bool) -> set[Path]:
    """Return the sessions that are too old, none where no session shows the clock to be right."""
    if keep.days is None:
        return set()
    ages_days: dict[Path, float] = {}
    for path in directories:
        # one that cannot be read is left for a person
        with suppress(RecordingError):
            ages_days[path] = (now - session.read_info(path).started).total_seconds() / _DAY_S
    least_days = min(_CONFIRMED_DAYS, 0.5 * keep.days)
    if by_person or any(least_days <= age_days <= keep.days for age_days in ages_days.values()):
        return {path for path, age_days in ages_days.items() if age_days > keep.days}
    return set()


def size_of(directory: Path) -> int:
    """Return the bytes of the files in a folder; what is removed meanwhile takes none."""
    size = 0
    for path in (Path(folder, name) for folder, _, names in os.walk(directory) for name in names):
        with suppress(OSError):
            size += path.stat().st_size if path.is_file() else 0
    return size
