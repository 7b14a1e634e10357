"""Decoders of what is on the disk: checkpoint, session, its tables and events, and the journal."""

from __future__ import annotations

import asyncio
import functools
import shutil
import sqlite3
from pathlib import Path

import pyarrow as pa
import structlog

from adaptdrive.app.checkpoint import (
    CheckpointError,
    Learnt,
    configuration_key,
    read_checkpoint,
    write_checkpoint,
)
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import load_configuration
from adaptdrive.control.load import Load
from adaptdrive.control.settings import Jacket
from adaptdrive.errors import RecordingError
from adaptdrive.operation.journal import Journal
from adaptdrive.operation.memory import ReplyMemory
from adaptdrive.operation.outbox import Outbox
from adaptdrive.operation.trip_memory import TripMemory
from adaptdrive.recording import event_log
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.session import CONFIG_FILE, EVENTS_FILE, INFO_FILE
from adaptdrive.recording.streams import StreamWriter
from tests.fuzz.target import EXAMPLES, Target, damaged_file, scratch
from tests.recording.material import INFO


@functools.cache
def _motor() -> tuple[str, Load, Jacket]:
    motor = load_configuration(EXAMPLES / "motor.toml")
    return configuration_key(motor), build_load(motor), controller_settings(motor).jacket


def checkpoint(data: bytes) -> object:
    """Read a checkpoint."""
    key, load, jacket = _motor()
    return read_checkpoint(damaged_file("motor.estimates.json", data), key, load, jacket, span=6.0)


def session(data: bytes) -> object:
    """Read a session whose description is damaged."""
    (_session_folder() / EVENTS_FILE).unlink(missing_ok=True)
    return _read(INFO_FILE, data)


def events(data: bytes) -> object:
    """Read a session whose events and commands are damaged."""
    (_session_folder() / INFO_FILE).write_bytes(_SESSION)
    return _read(EVENTS_FILE, data)


def table(data: bytes) -> object:
    """Read a session whose ticks are damaged, as the recorder of a killed daemon left them."""
    (_session_folder() / INFO_FILE).write_bytes(_SESSION)
    (_session_folder() / EVENTS_FILE).unlink(missing_ok=True)
    (_session_folder() / "ticks-0001.arrows").write_bytes(data)
    return read_session(_session_folder()).ticks


def _read(name: str, data: bytes) -> object:
    (_session_folder() / name).write_bytes(data)
    return read_session(_session_folder())


@functools.cache
def _session_folder() -> Path:
    folder = scratch() / "session"
    folder.mkdir()
    shutil.copy(EXAMPLES / "motor.toml", folder / CONFIG_FILE)
    return folder


class _Prompt(Journal):
    """A journal without a thread and a log: a query is answered where it is asked."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._log = structlog.wrap_logger(structlog.ReturnLogger())

    async def rows(self, query: str) -> list[tuple[object, ...]]:
        return self._rows(query)


def journal(data: bytes) -> object:
    """Open a journal and recall replies, events and the last trip from it."""
    for old in scratch().glob("journal.sqlite*"):
        old.unlink()
    kept = _Prompt(damaged_file("journal.sqlite", data))
    kept._open()
    found = asyncio.run(_recalled(kept))
    kept._close()
    return found


async def _recalled(kept: Journal) -> tuple[object, ...]:
    memory = ReplyMemory(kept, lambda: INFO.started, lambda: 1000.0)
    outbox, trips = Outbox(kept, lambda: INFO.started), TripMemory(kept)
    counts = await memory.load(), await outbox.load(), await trips.load()
    return counts, memory.recall("a"), trips.last


def _database(name: str, *statements: str) -> bytes:
    """A database of the smallest pages, so that damage meets what is in it."""
    path = scratch() / name
    path.unlink(missing_ok=True)
    with sqlite3.connect(path) as database:
        for statement in ("PRAGMA page_size = 512", *statements):
            database.execute(statement)
    database.close()
    return path.read_bytes()


def _events() -> bytes:
    row = "(1, '2026-01-01T00:00:00+00:00', 5.0, 7"
    return _database(
        "events.good",
        *event_log._TABLES.split(";")[:2],
        f"INSERT INTO events VALUES {row}, 'trip', 'error', 'stale')",
        f"INSERT INTO commands VALUES {row}, 'mode', 'fixed', 'x', 1, '')",
    )


def _journal() -> bytes:
    reply = '{"id":"a","verb":"enable","accepted":true,"reason":"","state":"running"}'
    trip = '{"time":"2026-01-01T00:00:00Z","text":"stale: measurement is 54 ms old"}'
    return _database(
        "journal.good",
        "CREATE TABLE reply (id TEXT PRIMARY KEY, time_s REAL, body BLOB)",
        "CREATE TABLE event (sequence INTEGER PRIMARY KEY, body BLOB)",
        "CREATE TABLE trip (id INTEGER PRIMARY KEY, body BLOB)",
        f"INSERT INTO reply VALUES ('a', 1.0, CAST('{reply}' AS BLOB))",
        "INSERT INTO event VALUES (5, x'7b7d')",
        f"INSERT INTO trip VALUES (1, CAST('{trip}' AS BLOB))",
    )


def _ticks() -> bytes:
    path = scratch() / "ticks.good"
    batch = pa.RecordBatch.from_pydict({"sequence": [0, 1], "output": [1.0, 2.0]})
    writer = StreamWriter(path, batch.schema)
    writer.write(batch)
    writer.write(batch)
    writer.close()
    return path.read_bytes()


def _checkpoint() -> bytes:
    key, load, _ = _motor()
    values = load.physical(list(load.numerator), list(load.denominator))
    path = scratch() / "checkpoint.good"
    write_checkpoint(path, key, load.names, Learnt(tuple(values), 0.0049))
    return path.read_bytes()


_SESSION = (
    b'{"drive":"motor","version":"0.1.0","started":"2026-01-01T00:00:00Z","ticks_per_period":120,'
    b'"latency_ticks":2,"line_frequency_Hz":60.0,"ended":"orderly","format":1}'
)

DISKS: dict[str, Target] = {
    "checkpoint": Target(checkpoint, (CheckpointError,), (_checkpoint(),), 300, 0.5),
    "session": Target(session, (RecordingError,), (_SESSION,), 200, 0.5),
    "events": Target(events, (RecordingError,), (_events(),), 100, 0.2),
    "table": Target(table, (RecordingError,), (_ticks(),), 100, 0.2),
    "journal": Target(journal, (), (_journal(),), 60, 0.2),
}
