"""Reading a session back, however it ended, and verifying its files."""

import math
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path

import pyarrow as pa

from adaptdrive.recording import records, session, tables
from adaptdrive.recording.segments import KINDS, Batches, Segment, read_notes, segments
from adaptdrive.util.errors import RecordingError, reason_of
from adaptdrive.util.files import read_regular

# Reading a session back, however it ended, or while it is written.

_LARGEST_TEXT_BYTES = 4 << 20
"""A configuration of a million characters, the longest that is accepted."""

_INCOMPLETE = "not all of its events and commands can be read"


@dataclass(frozen=True)
class Session:
    """A recorded session; its tables, events and commands are read when they are asked for.

    Attributes:
        path: Its directory.
        info: Contents of `session.json`.
        config_text: The configuration it ran with, as TOML.
    """

    path: Path
    info: session.SessionInfo
    config_text: str

    @cached_property
    def ticks(self) -> pa.Table:
        """Fast ticks, all of them in memory."""
        return self.table(session.TableName.TICKS)

    @property
    def events(self) -> tuple[records.EventRow, ...]:
        """Events in their order."""
        return self._notes[0]

    @property
    def commands(self) -> tuple[records.CommandRow, ...]:
        """Operator commands in their order."""
        return self._notes[1]

    @property
    def damage(self) -> str:
        """Why `events` or `commands` lack some; empty otherwise."""
        return self._notes[2]

    @cached_property
    def _notes(self) -> tuple[tuple[records.EventRow, ...], tuple[records.CommandRow, ...], str]:
        damage: list[str] = []
        found = segments(self.path, self.info, tables.NOTE_ROWS)
        events, commands = read_notes(found, damage)
        return events, commands, "; ".join([*damage, _INCOMPLETE]) if damage else ""

    def table(self, name: str) -> pa.Table:
        """Return a table, all of it in memory; raises as `batches`."""
        schema = tables.table_schema(name, self.info)
        return pa.Table.from_batches(list(self.batches(name)), schema)

    def batches(self, table: str, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the rows of a table a batch at a time.

        Args:
            table: Name of the table.
            columns: The columns wanted, None for all.

        Raises:
            RecordingError: A file is damaged, or holds another table; a value of an enumeration
                that is none of it shows that, too.
        """
        for batches in self._segments(table, columns):
            for _, batch in batches:
                yield batch

    def ends(
        self, table: str, columns: Sequence[str]
    ) -> tuple[pa.RecordBatch, pa.RecordBatch] | None:
        """Return the first and the last rows of a table, without those between; None without rows.

        Args:
            table: Name of the table.
            columns: The columns wanted.

        Raises:
            RecordingError: As for `batches`.
        """
        first = next(self.batches(table, columns), None)
        for batches in reversed(self._segments(table, columns)):
            for _, last in deque(batches, maxlen=1):
                return first, last
        return None

    @property
    def last_tick(self) -> datetime | None:
        """Time of the last recorded tick, None where that is not recorded."""
        ends = self.ends(session.TableName.TICKS, ("utc",))
        found: datetime | None = ends and ends[1].column("utc")[-1].as_py()
        return found

    def _segments(self, table: str, columns: Sequence[str] | None) -> list[Batches]:
        """Return the rows of each segment of a table, read when they are asked for."""
        schema = tables.table_schema(table, self.info)
        if columns is not None:
            schema = pa.schema([schema.field(name) for name in columns])
        found = segments(self.path, self.info, (table,))
        return [segment.rows({table: schema}) for segment in found]


def session_notes(
    directory: Path,
) -> tuple[tuple[records.EventRow, ...], tuple[records.CommandRow, ...]]:
    """Return the events and commands of a session, also where its facts are lost.

    Args:
        directory: Directory of the session.

    Raises:
        RecordingError: They are damaged.
    """
    info = None
    with suppress(RecordingError):
        info = session.read_info(directory)
    return read_notes(segments(directory, info, tables.NOTE_ROWS))


def read_session(path: Path) -> Session:
    """Read a session that has ended in any way, or is still being written.

    Damaged events and commands leave the tables readable: `Session.damage` names them.

    Args:
        path: Directory of the session.

    Raises:
        RecordingError: There is no session, or its facts or configuration are damaged.
    """
    return Session(path, session.read_info(path), _read_text(path / session.CONFIG_FILE))


def _read_text(path: Path) -> str:
    try:
        return read_regular(path, _LARGEST_TEXT_BYTES).decode()
    except OSError as problem:
        raise RecordingError(path, reason_of(problem)) from problem
    except UnicodeDecodeError as problem:
        raise RecordingError(path, str(problem)) from problem


def find_session(name: str | None, sessions: Path) -> Path:
    """Return the session that an operator names by path, or by its name in `sessions`.

    Its path ends in the name of the session also where that was given as `.` or `..`.

    Args:
        name: Path or name, None for the last session.
        sessions: Folder of the sessions.

    Raises:
        RecordingError: There is none.
    """
    if name is None:
        *_, last = (None, *session.session_directories(sessions))
        if last is None:
            raise RecordingError(sessions, session.NO_SESSION)
        return last
    for directory in (Path(name), sessions / name):
        if session.has_any(directory, session.PARTS):
            return directory if directory.name.strip(".") else directory.resolve()
    raise RecordingError(name, f"no such session, neither as a path nor in {sessions}")


# Verification: every page of every file of a session is read and held against its checksum.


@dataclass(frozen=True, slots=True)
class Verification:
    """Result of a verification.

    Attributes:
        rows: Rows that can be read, by table.
        missing_ticks: Ticks that the running numbers show to be missing, or that the recorder
            has counted as lost: those at the end have no running number.
        problems: What is damaged or was not recorded, in words.
    """

    rows: dict[str, int]
    missing_ticks: int
    problems: tuple[str, ...]

    @property
    def whole(self) -> bool:
        """True when nothing is damaged and nothing is missing."""
        return not self.problems and not self.missing_ticks


def verify(recorded: Session) -> Verification:
    """Read all of a session once, a batch at a time.

    Args:
        recorded: The session.
    """
    info, problems = recorded.info, list[str]()
    schemas = {table: tables.table_schema(table, info) for table in KINDS}
    count = _Count(info.first_sequence)
    for segment in segments(recorded.path, info):
        try:
            for table, batch in segment.rows(schemas, problems):
                count.take(segment, table, batch)
        except RecordingError as problem:
            problems.append(f"{segment.path.name}: {problem.problem}")
    rows = count.rows
    problems += [*_missing(info, rows), *info.losses]
    # a whole file that is gone leaves no gap in the running numbers
    gone = info.rows.get(session.TableName.TICKS, 0) - rows[session.TableName.TICKS]
    missing = max(count.missing_ticks, info.dropped.ticks, gone)
    shown = {table: rows[table] for table in session.TABLES if table in rows}
    return Verification(shown, missing, tuple(dict.fromkeys(problems)))


class _Count:
    """Rows of a session, in the order in which they must be.

    Attributes:
        missing_ticks: Ticks between those that were counted.
        rows: Rows by table.
    """

    def __init__(self, first_sequence: int) -> None:
        self.missing_ticks = 0
        self.rows = Counter[str]()
        self._next_sequence = first_sequence
        self._last: dict[str, float] = {}

    def take(self, segment: Segment, table: str, batch: pa.RecordBatch) -> None:
        """Count the rows of a batch.

        Raises:
            RecordingError: They are not later than those before them, as in a copy of a file.
        """
        key = KINDS[table][2]
        first, last = (batch.column(key)[place].as_py() for place in (0, -1))
        if first is None or last is None:
            raise RecordingError(segment.path, f"it does not hold the {key} of each row")
        if first <= self._last.get(table, -math.inf):
            raise RecordingError(segment.path, "its rows are not later than those before them")
        self._last[table] = last
        if table == session.TableName.TICKS:
            self.missing_ticks += last + 1 - self._next_sequence - batch.num_rows
            self._next_sequence = last + 1
        self.rows[table] += batch.num_rows


def _missing(info: session.SessionInfo, rows: Mapping[str, int]) -> Iterator[str]:
    """Yield what is missing but ticks, which are counted on their own."""
    for table, number in info.rows.items():
        missing = number - rows[table]
        if table != session.TableName.TICKS and missing > 0:
            yield f"{missing} of {number} rows of the table {table} are missing"
    for kind, number in {"slow steps": info.dropped.slow, "events": info.dropped.events}.items():
        if number:
            yield f"{number} {kind} were not recorded"
