"""Reading a session back, however it ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
from pyarrow import parquet as pq

from adaptdrive.errors import RecordingError
from adaptdrive.recording.batches import EventRow
from adaptdrive.recording.event_log import read_events
from adaptdrive.recording.session import (
    CONFIG_FILE,
    EVENTS_FILE,
    SLOW,
    TICKS,
    SessionInfo,
    read_info,
)
from adaptdrive.recording.streams import StreamReader
from adaptdrive.recording.tables import SLOW_SCHEMA, TICKS_SCHEMA


@dataclass(frozen=True, slots=True)
class Session:
    """A recorded session.

    Attributes:
        path: Its directory.
        info: What `session.json` says.
        config_text: The configuration it ran with, as TOML.
        ticks: Fast ticks.
        slow: Slow steps.
        events: Events in their order.
        torn: True when a table broke off in the middle of a batch, which is left out.
    """

    path: Path
    info: SessionInfo
    config_text: str
    ticks: pa.Table
    slow: pa.Table
    events: tuple[EventRow, ...]
    torn: bool


def read_session(path: Path) -> Session:
    """Read a session that has ended in any way, or is still being written.

    Args:
        path: Directory of the session.

    Raises:
        RecordingError: There is no session, or it is damaged beyond a torn tail.
    """
    info = read_info(path)
    ticks, ticks_torn = _read_table(path, TICKS, TICKS_SCHEMA)
    slow, slow_torn = _read_table(path, SLOW, SLOW_SCHEMA)
    return Session(
        path=path,
        info=info,
        config_text=_read_text(path / CONFIG_FILE),
        ticks=ticks,
        slow=slow,
        events=read_events(path / EVENTS_FILE),
        torn=ticks_torn or slow_torn,
    )


def _read_table(directory: Path, name: str, schema: pa.Schema) -> tuple[pa.Table, bool]:
    parquet = directory / f"{name}.parquet"
    if parquet.exists():
        return _read_parquet(parquet, schema), False
    reader = StreamReader(directory / f"{name}.arrows", schema)
    return pa.Table.from_batches(list(reader.batches()), schema), reader.torn


def _read_parquet(path: Path, schema: pa.Schema) -> pa.Table:
    try:
        with pq.ParquetFile(path) as file:
            table = file.read()
    except (pa.ArrowException, OSError) as problem:
        raise RecordingError(path, str(problem)) from problem
    if table.schema != schema:
        raise RecordingError(path, "its columns are not those known here")
    return table


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        raise RecordingError(path, str(problem)) from problem
