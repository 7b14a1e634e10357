"""Verification: every page of every file of a session is read and held against its checksum."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import pyarrow as pa

from adaptdrive.errors import RecordingError
from adaptdrive.recording.reader import Session
from adaptdrive.recording.segments import Segment, segments
from adaptdrive.recording.session import TABLES, SessionInfo, TableName
from adaptdrive.recording.tables import table_schema


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


def verify(session: Session) -> Verification:
    """Read all of a session, a batch at a time.

    Args:
        session: The session.
    """
    problems: list[str] = []
    count = _Count(session.info.first_sequence)
    for segment in segments(session.path, session.info):
        try:
            for batch in segment.rows(table_schema(segment.table, session.info), problems):
                count.take(segment, batch)
        except RecordingError as problem:
            problems.append(f"{segment.path.name}: {problem.problem}")
    info, rows = session.info, count.rows
    problems += [*_missing(info, rows), *info.losses]
    # a whole file that is gone leaves no gap in the running numbers
    gone = info.rows.get(TableName.TICKS, 0) - rows.get(TableName.TICKS, 0)
    missing = max(count.missing_ticks, info.dropped.ticks, gone)
    shown = {table: rows[table] for table in TABLES if table in rows}
    return Verification(shown, missing, tuple(dict.fromkeys(problems)))


@dataclass(slots=True)
class _Count:
    """Rows of a session, in the order in which they must be.

    Attributes:
        next_sequence: Running number of the next tick.
        missing_ticks: Ticks between those that were counted.
        rows: Rows by table.
        last: Last key by table.
    """

    next_sequence: int
    missing_ticks: int = 0
    rows: dict[str, int] = field(default_factory=dict)
    last: dict[str, float] = field(default_factory=dict)

    def take(self, segment: Segment, batch: pa.RecordBatch) -> None:
        """Count the rows of a batch.

        Raises:
            RecordingError: They are not later than those before them, as in a copy of a file.
        """
        table, key = segment.table, segment.key
        first, last = (batch.column(key)[place].as_py() for place in (0, -1))
        if first is None or last is None:
            raise RecordingError(segment.path, f"it does not hold the {key} of each row")
        if first <= self.last.get(table, -math.inf):
            raise RecordingError(segment.path, "its rows are not later than those before them")
        self.last[table] = last
        if table == TableName.TICKS:
            self.missing_ticks += last + 1 - self.next_sequence - batch.num_rows
            self.next_sequence = last + 1
        self.rows[table] = self.rows.get(table, 0) + batch.num_rows


def _missing(info: SessionInfo, rows: Mapping[str, int]) -> Iterator[str]:
    """Yield what is missing but ticks, which are counted on their own."""
    for table, number in info.rows.items():
        missing = number - rows.get(table, 0)
        if table != TableName.TICKS and missing > 0:
            yield f"{missing} of {number} rows of the table {table} are missing"
    for kind, number in {"slow steps": info.dropped.slow, "events": info.dropped.events}.items():
        if number:
            yield f"{number} {kind} were not recorded"
