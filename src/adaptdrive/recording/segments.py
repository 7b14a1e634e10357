"""Segments of a session's tables on disk, and which of them go first when space is short.

Ages follow the wall clock, which may be wrong at the start of a machine. A recorder removes
sessions for their age only while one session, its own included, began at least a day and at most
`keep.days` ago: after the clock has leapt ahead there is none.

A symbolic link to a session, such as one that was moved to another disk, takes no room here: it is
neither counted nor removed.
"""

import contextlib
import math
import os
import re
import shutil
import stat
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from adaptdrive.recording import journal_files, session, tables
from adaptdrive.recording.records import ROW_KINDS, CommandRow, EventRow, Keep, Kind, Record, Ticks
from adaptdrive.runtime.reports import BINS, MONOTONIC, bin_of
from adaptdrive.util.errors import NOT_JSON, RecordingError

# Segments of a session's tables: Parquet files, and after them what is in the log only.

Batches = Iterator[pa.RecordBatch]
_TIMES = ("lateness_us", "turnaround_us", "tick_us")
_TICKS_AT_ONCE = 5_000
_ROWS_AT_ONCE = 200
"""Rows of a batch: as Python values they take many times their size on disk."""

KINDS: dict[str, tuple[Kind, Any, str]] = {
    session.TableName.TICKS: (Kind.TICKS, Ticks, "sequence"),
    session.TableName.SLOW: (Kind.SLOW, list[dict[str, Any]], MONOTONIC),
    session.TableName.SENSORS: (Kind.SENSORS, list[dict[str, Any]], MONOTONIC),
    session.TableName.EVENTS: (Kind.EVENT, EventRow, "number"),
    session.TableName.COMMANDS: (Kind.COMMAND, CommandRow, "number"),
}
"""Kind and contents of the records of each table, and its column that only ever grows."""

_NAME = re.compile(rf"({'|'.join(KINDS)})-(\d{{4,}})\.parquet")


@dataclass(frozen=True, slots=True, order=True)
class Segment:
    """One segment of one table.

    Attributes:
        number: From 1.
        table: Name of the table.
        path: Its Parquet file, which is not made yet where it is in the log.
        logged: Files of the log that hold it; none once there is the Parquet file.
    """

    number: int
    table: str
    path: Path
    logged: tuple[journal_files.LogFile, ...] = ()

    @property
    def key(self) -> str:
        """Name of its column that only ever grows."""
        return KINDS[self.table][2]

    def rows(self, schema: pa.Schema, losses: list[str] | None = None) -> Batches:
        """Yield its rows a batch at a time.

        Args:
            schema: The columns wanted, of those of its table.
            losses: Takes what of the log cannot be read, in words.

        Raises:
            RecordingError: The file is damaged, or holds another table.
        """
        if not self.logged or self.path.exists():  # perhaps since it was listed
            yield from tables.read_parquet(self.path, schema)
        else:
            yield from logged_batches(self.logged, self.table, schema, losses)

    def notes(self) -> list[Any]:
        """Return its events or commands.

        Raises:
            RecordingError: They are damaged.
        """
        try:
            schema, kind = tables.table_schema(self.table), KINDS[self.table][1]
            rows = (row for batch in self.rows(schema) for row in batch.to_pylist())
            return [msgspec.convert(row, kind) for row in rows]
        except (msgspec.ValidationError, ValueError, OverflowError) as problem:
            raise RecordingError(self.path, f"damaged {self.table}: {problem}") from problem


def parquet_path(directory: Path, table: str, number: int) -> Path:
    """Return the path of a segment."""
    return directory / f"{table}-{number:04}.parquet"


def segments(directory: Path, info: session.SessionInfo, table: str | None = None) -> list[Segment]:
    """Return the segments of one table or of all, in their order.

    Args:
        directory: Directory of the session.
        info: Its facts.
        table: Name of the table, None for all.

    Raises:
        RecordingError: The folder of the log cannot be read.
    """
    wanted = KINDS if table is None else (table,)
    found: dict[tuple[int, str], Segment] = {}
    for part, group in groupby(journal_files.unarchived(directory, info), lambda file: file.part):
        files = tuple(group)
        for name in wanted:
            path = parquet_path(directory, name, part)
            found[part, name] = Segment(part, name, path, files)
    closed = (one for one in closed_segments(directory) if one.table in wanted)
    found |= {(one.number, one.table): one for one in closed}
    return sorted(found.values())


def read_notes(found: Iterable[Segment], table: str, damage: list[str] | None = None) -> list[Any]:
    """Return the events or the commands in segments.

    Args:
        found: The segments, of any table.
        table: Name of the table.
        damage: Takes what cannot be read, in words; None to refuse that.

    Raises:
        RecordingError: They are damaged.
    """
    notes: list[Any] = []
    for segment in found:
        try:
            notes += segment.notes() if segment.table == table else ()
        except RecordingError as problem:
            if damage is None:
                raise
            damage.append(str(problem))
    return notes


def write_segment(
    directory: Path,
    info: session.SessionInfo,
    part: int,
    rows_of: Callable[[str], Batches],
) -> session.SessionInfo:
    """Write a segment of each table, and count its rows and the times of its ticks.

    Args:
        directory: Directory of the session.
        info: Its facts.
        part: Number of the segment.
        rows_of: Returns the rows of a table.

    Returns:
        Its facts with the segment.

    Raises:
        RecordingError: Its rows cannot be read.
        OSError: It cannot be written.
    """
    rows = dict(info.rows)
    times = {name: list(info.histograms.get(name, [0] * BINS)) for name in _TIMES}
    for table in KINDS:
        counted = _counted(rows_of(table), table, rows, times)
        tables.write_parquet(parquet_path(directory, table, part), counted)
    histograms = {name: tuple(counts) for name, counts in times.items()}
    return msgspec.structs.replace(info, segments=part, rows=rows, histograms=histograms)


def _counted(
    batches: Batches, table: str, rows: dict[str, int], times: dict[str, list[int]]
) -> Batches:
    for batch in batches:
        rows[table] = rows.get(table, 0) + batch.num_rows
        for name, counts in times.items() if table == session.TableName.TICKS else ():
            for time_us in batch.column(name).to_pylist():
                if not math.isnan(time_us):  # a stand-in tick has no turnaround
                    counts[bin_of(time_us)] += 1
        yield batch


def closed_segments(directory: Path) -> list[Segment]:
    """Return the Parquet files of a session, in their order."""
    return [
        Segment(int(match[2]), match[1], path)
        for path in sorted(directory.iterdir())
        if (match := _NAME.fullmatch(path.name))
    ]


def logged_batches(
    files: Sequence[journal_files.LogFile],
    table: str,
    schema: pa.Schema,
    losses: list[str] | None = None,
) -> Iterator[pa.RecordBatch]:
    """Yield the rows of a table in files of the log.

    Args:
        files: Files of one segment of a session, in their order.
        table: Name of the table.
        schema: Its columns.
        losses: Takes what cannot be read, in words.

    Raises:
        RecordingError: A file cannot be read at all.
    """
    losses = [] if losses is None else losses
    kind, contents, _ = KINDS[table]
    timed: list[tuple[Any, float]] = []
    rows = 0
    for record in journal_files.records(files, losses):
        found = content_of(record, contents, losses) if record.kind is kind else None
        if found is None:
            continue
        if table in tables.NOTE_ROWS:
            found = [msgspec.structs.asdict(found)]
        timed.append((found, record.wall_s - record.monotonic_s))
        rows += found.rows if isinstance(found, Ticks) else len(found)
        if rows >= (_TICKS_AT_ONCE if table == session.TableName.TICKS else _ROWS_AT_ONCE):
            # they are given up before the batch is taken
            made, timed, rows = _made(timed, table, schema, losses), [], 0
            yield from made
    if rows:
        yield from _made(timed, table, schema, losses)


def _made(
    timed: Sequence[tuple[Any, float]], table: str, schema: pa.Schema, losses: list[str]
) -> list[pa.RecordBatch]:
    """Return a batch, or note that its rows do not fit their table, as those of another version."""
    batch = tables.ticks_batch if table == session.TableName.TICKS else tables.rows_batch
    try:
        return [batch(timed, schema)]
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


# Retention: the oldest sessions go first, then the oldest segments of the session in progress.

_DAY_S = 86_400.0

_CONFIRMED_DAYS = 1.0
"""Age of the session that confirms the clock: a wrong one is noticed or set within this time."""


def prune(sessions: Path, keep: Keep, now: datetime, current: Path | None = None) -> Iterator[str]:
    """Remove what is too old or too much.

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
    directories = [path for path in session.session_directories(sessions) if not path.is_symlink()]
    older = [path for path in directories if path != current]
    outdated = _too_old(directories, keep, now, by_person=current is None)
    excess = sum(map(size_of, directories)) - keep.bytes if keep.bytes is not None else 0
    failed: list[RecordingError] = []
    for directory in older:
        size = size_of(directory)
        if excess > 0:
            cause = f"sessions take more than {(keep.bytes or 0) / 1e6:g} MB"
        elif directory in outdated:
            cause = f"it is older than {keep.days:g} days"
        else:
            continue
        try:
            removed = _remove(directory)
        except FileNotFoundError:
            continue  # another drive that shares the folder, or a person, has removed it
        except OSError as problem:
            failed.append(RecordingError(directory, f"the session cannot be removed: {problem}"))
            continue
        if removed:
            excess -= size
            yield f"session {directory.name} removed: {cause}"
    if current is not None and excess > 0:
        yield from _prune_segments(current, excess)
    if failed:
        raise failed[0]


def _prune_segments(directory: Path, excess: int) -> Iterator[str]:
    for segment in closed_segments(directory):
        if segment.table in tables.NOTE_ROWS:
            continue
        if excess <= 0:
            return
        excess -= segment.path.stat().st_size
        segment.path.unlink()
        yield f"{segment.path.name} of session {directory.name} removed: sessions take too much"


def _remove(directory: Path) -> bool:
    # nobody writes a session whose facts cannot be read
    with contextlib.suppress(RecordingError):
        if journal_files.in_progress(directory, session.read_info(directory)):
            return False
    shutil.rmtree(directory)
    return True


def _too_old(directories: list[Path], keep: Keep, now: datetime, *, by_person: bool) -> set[Path]:
    """Return the sessions that are too old, none where no session shows the clock to be right."""
    if keep.days is None:
        return set()
    ages_days: dict[Path, float] = {}
    for path in directories:
        # one that cannot be read is left for a person
        with contextlib.suppress(RecordingError):
            ages_days[path] = (now - session.read_info(path).started).total_seconds() / _DAY_S
    least_days = min(_CONFIRMED_DAYS, 0.5 * keep.days)
    if by_person or any(least_days <= age_days <= keep.days for age_days in ages_days.values()):
        return {path for path, age_days in ages_days.items() if age_days > keep.days}
    return set()


def size_of(directory: Path) -> int:
    """Return the bytes of the files in a folder; what is removed meanwhile takes none."""
    size = 0
    for folder, _, names in os.walk(directory):
        for name in names:
            with contextlib.suppress(OSError):
                found = Path(folder, name).stat()
                size += found.st_size if stat.S_ISREG(found.st_mode) else 0
    return size
