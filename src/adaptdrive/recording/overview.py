"""Overviews of sessions for a page that reads static files: `overview.json` and `index.json`.

An overview has the curves of a session in some thousand points, least and most values kept, and its
events. It is a fold over the closed segments, so that each is read once. The index of a folder
lists its sessions. Both are made from the folders alone: one that is removed is made again.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import pyarrow as pa

from adaptdrive.recording import segments, session, tables
from adaptdrive.recording.records import CommandRow, EventRow
from adaptdrive.runtime.reports import MONOTONIC
from adaptdrive.util.errors import NOT_JSON, RecordingError
from adaptdrive.util.files import alone, read_regular, replace_regular
from adaptdrive.util.quantity import Display

T = TypeVar("T")

# Curves: the columns of a table, in few points.

MOST_POINTS = 5_000
"""More than a screen has columns; a curve that exceeds them is thinned to one half."""

_DIGITS = 7
"""Significant digits of a value: more than a figure shows."""


class Column(msgspec.Struct):
    """Values of one column.

    Attributes:
        unit: Their unit, empty for a plain number; None where the name alone gives it.
        values: One for each point, None for none.
    """

    unit: str | None
    values: list[float | None] = []


class Curves(msgspec.Struct):
    """Columns of a table over time.

    Attributes:
        time_s: Time of each point since the beginning.
        rows_per_point: Rows between two points: 1 while each row is one, else two points have the
            least and the most value of twice as many rows, in their order.
        columns: Columns by name.
    """

    time_s: list[float] = []
    rows_per_point: int = 1
    columns: dict[str, Column] = {}

    def take(self, time_s: Sequence[float], columns: Mapping[str, Column]) -> None:
        """Append rows.

        Args:
            time_s: Their times since the beginning.
            columns: Their values.
        """
        group = 2 * self.rows_per_point if self.rows_per_point > 1 else 1
        for name, column in columns.items():
            self.columns.setdefault(name, Column(column.unit, [None] * len(self.time_s)))
        for name, column in self.columns.items():
            values = columns[name].values if name in columns else [None] * len(time_s)
            column.values += [_rounded(value) for value in thinned(values, group)]
        self.time_s += [round(at_s, 4) for at_s in ends(time_s, group)]
        while len(self.time_s) > MOST_POINTS:
            self._thin()

    def _thin(self) -> None:
        self.rows_per_point *= 2
        self.time_s = ends(self.time_s, 4)
        for column in self.columns.values():
            column.values = thinned(column.values, 4)


def thinned(values: Sequence[float | None], group: int) -> list[float | None]:
    """Return the least and the most value of each group, in their order; None for unknown ones."""
    if group == 1:
        return list(values)
    return [
        one for at in range(0, len(values), group) for one in _extremes(values[at : at + group])
    ]


def _extremes(values: Sequence[float | None]) -> tuple[float | None, float | None]:
    known = [value for value in values if value is not None and value == value]  # noqa: PLR0124 - NaN
    if not known:
        return None, None
    least, most = min(known), max(known)
    return (least, most) if known.index(least) <= known.index(most) else (most, least)


def ends(times_s: Sequence[float], group: int) -> list[float]:
    """Return the first and the last time of each group."""
    if group == 1:
        return list(times_s)
    parts = (times_s[at : at + group] for at in range(0, len(times_s), group))
    return [at_s for part in parts for at_s in (part[0], part[-1])]


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.{_DIGITS}g}")


# The overview of a session.

OVERVIEW_FILE = "overview.json"

_OF_TABLES: dict[str, Sequence[str]] = {
    session.TableName.TICKS: (
        *("output", "reference", "boost_voltage_V", "command_boost_reference_V"),
        *("load_power_W", "line_voltage_V"),
    ),
    session.TableName.SLOW: ("estimates",),
}
"""Columns of a table that an overview has; of the sensors all but their ages."""
_COUNT = "latency"
"""Kind of an event that comes each minute, and shows nothing of the drive."""

_ROWS_AT_ONCE = 1 << 12
"""Rows that are numbers of Python at a time: these take several times their size on disk."""

_MOST_NOTES = 2_000
_LARGEST_BYTES = 1 << 24


class Note(msgspec.Struct, frozen=True):
    """One event, or one command that was carried out.

    Attributes:
        time_s: Time since the beginning.
        kind: Kind of the event, or `command`.
        severity: How much it matters.
        detail: One sentence.
        trip_kind: Kind of the trip, None where it is none.
    """

    time_s: float
    kind: str
    severity: str
    detail: str
    trip_kind: str | None = None


class Overview(msgspec.Struct):
    """Contents of `overview.json`.

    Attributes:
        drive: Name of the drive.
        version: Version of adaptdrive that recorded it.
        given: Name of what the drive is commanded, and gives.
        segments: Number of the last segment in it.
        zero_s: Monotonic time of the beginning, None while nothing is recorded.
        began: Time of the beginning, UTC.
        tables: Curves of each table, by name.
        notes: Events and commands in their order, the last ones of very many.
        damage: What could not be read, in words.
        files: Bytes of each Parquet file.
        display: Unit in which people see the output, None for its own.
    """

    drive: str
    version: str
    given: str
    segments: int = 0
    zero_s: float | None = None
    began: datetime | None = None
    tables: dict[str, Curves] = {}
    notes: list[Note] = []
    damage: list[str] = []
    files: dict[str, int] = {}
    display: Display | None = None

    @property
    def end(self) -> datetime | None:
        """Time of the last row of a table, UTC; None without one."""
        last_s = [curves.time_s[-1] for curves in self.tables.values() if curves.time_s]
        return self.began + timedelta(seconds=max(last_s)) if self.began and last_s else None

    def since(self, monotonic_s: float | None, utc: datetime) -> float:
        """Return a time since the beginning, which is the first one asked for.

        Raises:
            RecordingError: It is none, as in a damaged row.
        """
        if monotonic_s is None or not math.isfinite(monotonic_s):
            raise RecordingError(MONOTONIC, f"{monotonic_s} is no time")
        if self.zero_s is None:
            self.zero_s, self.began = monotonic_s, utc.astimezone(UTC)
        return monotonic_s - self.zero_s


def refresh(directory: Path, info: session.SessionInfo) -> Overview:
    """Take the segments of a session that are closed since into its overview.

    Args:
        directory: Directory of the session.
        info: Its facts.

    Returns:
        The overview; what of the session is damaged is left out, and named in it.

    Raises:
        RecordingError: The folder cannot be read.
        OSError: The overview cannot be written.
    """
    written = _read(directory / OVERVIEW_FILE, Overview)
    given = info.manipulated.name
    found = written or Overview(info.drive, info.version, given, display=info.display)
    new = range(found.segments + 1, info.segments + 1)  # one beyond is not whole yet
    for segment in sorted(segments.segments(directory, None), key=_place):
        if segment.number not in new:
            continue
        try:
            _take(found, segment, info)
        except RecordingError as problem:
            found.damage.append(f"{segment.path.name}: {problem.problem}")
    found.segments = info.segments
    found.notes = sorted(found.notes, key=lambda note: note.time_s)[-_MOST_NOTES:]
    found.files = {path.name: path.stat().st_size for path in sorted(directory.glob("*.parquet"))}
    text = msgspec.json.encode(found)
    if written is None or text != (directory / OVERVIEW_FILE).read_bytes():
        replace_regular(directory / OVERVIEW_FILE, text)
    return found


def _place(segment: segments.Segment) -> tuple[int, bool]:
    """Return the place of a segment: the first tick is the beginning, where there is one."""
    return segment.number, segment.tables != (session.TableName.TICKS,)


def _read(path: Path, kind: type[T]) -> T | None:
    """Return what a file holds, None where it is absent, damaged or of another version."""
    try:
        return msgspec.json.decode(read_regular(path, _LARGEST_BYTES), type=kind)
    except (OSError, *NOT_JSON):
        return None


def _take(found: Overview, segment: segments.Segment, info: session.SessionInfo) -> None:
    (table,) = segment.tables
    if table in tables.NOTE_ROWS:
        events, commands = segments.read_notes([segment])
        found.notes += [_event(found, row) for row in events if row.kind != _COUNT]
        found.notes += [_command(found, row) for row in commands if row.accepted]
        return
    curves = found.tables.setdefault(table, Curves())
    for _, batch in segment.rows({table: _wanted(table, info)}):
        for at in range(0, batch.num_rows, _ROWS_AT_ONCE):
            rows = batch.slice(at, _ROWS_AT_ONCE)
            times_s, utc = _numbers(rows.column(MONOTONIC)), rows.column("utc")[0].as_py()
            curves.take([found.since(at_s, utc) for at_s in times_s], _columns(table, rows))


def _event(found: Overview, row: EventRow) -> Note:
    at_s = round(found.since(row.monotonic_s, row.time), 4)
    return Note(at_s, row.kind, row.severity, row.detail, row.trip_kind)


def _command(found: Overview, row: CommandRow) -> Note:
    at_s = round(found.since(row.monotonic_s, row.time), 4)
    value, user = row.value.replace("null", ""), row.user and f"by {row.user}"
    return Note(at_s, "command", "info", " ".join(filter(None, (row.verb, value, user))))


def _wanted(table: str, info: session.SessionInfo) -> pa.Schema:
    schema = tables.table_schema(table, info)
    wanted = _OF_TABLES.get(table, [one for one in schema.names[2:] if not one.endswith(".age_s")])
    names = ("utc", MONOTONIC, *wanted)
    return pa.schema([schema.field(name) for name in names])


def _columns(table: str, batch: pa.RecordBatch) -> Mapping[str, Column]:
    if table == session.TableName.SLOW:
        return _estimates(batch.column("estimates").to_pylist())
    fields = [one for one in batch.schema if one.name not in ("utc", MONOTONIC)]
    return {one.name: Column(_unit(one), _numbers(batch.column(one.name))) for one in fields}


def _estimates(rows: Sequence[Any]) -> dict[str, Column]:
    names = dict.fromkeys(one["name"] for row in rows for one in row or ())
    valued = [{one["name"]: one["value"] for one in row or ()} for row in rows]
    return {name: Column(None, [row.get(name) for row in valued]) for name in names}


def _unit(field: pa.Field) -> str:
    return str((field.metadata or {}).get(b"unit", b"").decode())


def _numbers(array: pa.Array) -> list[Any]:
    """Return the numbers of a column; from its bits, forty times faster than one by one."""
    if array.null_count or array.type != pa.float64():
        return list(array.to_pylist())
    values = memoryview(array.buffers()[1]).cast("d")
    return values[array.offset : array.offset + len(array)].tolist()


# The index of a folder of sessions.

INDEX_FILE = "index.json"


class TripEntry(msgspec.Struct, frozen=True):
    """The record of a trip.

    Attributes:
        record: Name of its folder, in that of the session.
        time: Time of the trip, UTC.
        text: Its cause.
    """

    record: str
    time: datetime
    text: str


class Entry(msgspec.Struct, frozen=True):
    """One session.

    Attributes:
        name: Name of its folder.
        drive: Name of the drive.
        started: Start, UTC.
        ended: How it ended.
        end: Time of its last row up to the last closed segment, UTC; None while there is none.
        bytes: Size of its folder.
        trips: Records of its trips, the first one first.
    """

    name: str
    drive: str
    started: datetime
    ended: session.Ending
    end: datetime | None
    bytes: int
    trips: tuple[TripEntry, ...] = ()


def update_index(sessions: Path, changed: Collection[str] = ()) -> None:
    """Make the index of a folder of sessions agree with it, and their overviews that are missing.

    Args:
        sessions: The folder.
        changed: Names of sessions that may differ from what the index has.

    Raises:
        RecordingError: One that has changed cannot be read.
        OSError: It cannot be written.
    """
    with alone(sessions):
        path = sessions / INDEX_FILE
        listed = _read(path, list[Entry]) or []
        known = {entry.name: entry for entry in listed if entry.name not in changed}
        entries = []
        for directory in session.session_directories(sessions):
            try:
                entries.append(known.get(directory.name) or _entry(directory))
            except (RecordingError, OSError):  # damaged, or moved to a disk that is only read
                if directory.name in changed:
                    raise
        if entries != listed or not path.exists():
            replace_regular(path, msgspec.json.encode(entries))


def _entry(directory: Path) -> Entry:
    info = session.read_info(directory)
    found = refresh(directory, info)
    trips = [_trip(path) for path in sorted(directory.glob(f"{session.TRIP_PREFIX}*"))]
    size = segments.size_of(directory)
    facts = directory.name, info.drive, info.started, info.ended, found.end, size
    return Entry(*facts, tuple(filter(None, trips)))


def _trip(directory: Path) -> TripEntry | None:
    """Return the record of a trip, None where it is damaged."""
    with suppress(RecordingError, OSError, ValueError):
        if not (directory / OVERVIEW_FILE).exists():
            refresh(directory, session.read_info(directory))
        time = directory.name.removeprefix(session.TRIP_PREFIX).partition("-")[0]
        at = datetime.strptime(time, session.TIME_IN_NAME).replace(tzinfo=UTC)
        cause, *_ = read_regular(directory / session.TRIP_TEXT).decode().splitlines()
        return TripEntry(directory.name, at, cause)
    return None
