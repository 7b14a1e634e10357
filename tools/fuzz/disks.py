"""Decoders of what is on the disk: checkpoint, session, its tables and events, and the log."""

from __future__ import annotations

import functools
import shutil
import zlib
from pathlib import Path

import msgspec
import pyarrow as pa

from adaptdrive.app.loads import build_load
from adaptdrive.app.recording import Learnt, checkpoint_record, configuration_key
from adaptdrive.app.recording import recall as recall_checkpoint
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration, load_configuration
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.recording.log_files import Begin, LogFile, Recalled, new_file, recall
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.records import EventRow, Header, Kind, Record, framed
from adaptdrive.recording.segments import logged_batches
from adaptdrive.recording.session import CONFIG_FILE, INFO_FILE, TABLES, TableName
from adaptdrive.recording.tables import NOTE_ROWS, table_schema, write_parquet
from adaptdrive.util.errors import RecordingError
from tests.unit.recording.material import INFO, make_batch, make_tick, write_log
from tools.fuzz.target import EXAMPLES, Target, scratch

_EVENTS_FILE = "events-0001.parquet"


@functools.cache
def _motor() -> tuple[Configuration, ControllerSettings, Load]:
    motor = load_configuration(EXAMPLES / "motor.toml")
    return motor, controller_settings(motor), build_load(motor)


def checkpoint(data: bytes) -> object:
    """Read a checkpoint."""
    return recall_checkpoint(data, *_motor())


def session(data: bytes) -> object:
    """Read a session whose description is damaged."""
    (_session_folder() / _EVENTS_FILE).unlink(missing_ok=True)
    return _read(INFO_FILE, data)


def events(data: bytes) -> object:
    """Read a session whose events and commands are damaged."""
    (_session_folder() / INFO_FILE).write_bytes(_SESSION)
    return _read(_EVENTS_FILE, data)


def table(data: bytes) -> object:
    """Read a session whose ticks are damaged."""
    (_session_folder() / INFO_FILE).write_bytes(_SESSION)
    (_session_folder() / _EVENTS_FILE).unlink(missing_ok=True)
    (_session_folder() / "ticks-0001.parquet").write_bytes(data)
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


def log(data: bytes) -> object:
    """Recall what a damaged file of the log holds, and read its rows and events."""
    file = _log_file()
    file.path.write_bytes(data)
    losses: list[str] = []
    schemas = {name: table_schema(name) for name in (*TABLES, *NOTE_ROWS)}
    list(logged_batches([file], schemas, losses))
    return recall(file.path.parent, INFO.started)


def payload(data: bytes) -> object:
    """Do the same with records whose checksum is right and whose contents are damaged."""
    begin = msgspec.msgpack.encode(Begin(Header(INFO, ""), 1))
    contents = [(Kind.BEGIN, begin), *((kind, data) for kind in Kind)]
    contents += [(kind, zlib.compress(data)) for kind in (Kind.TICKS, Kind.SLOW, Kind.SENSORS)]
    records = (Record(n, 1.0, 2.0, *one) for n, one in enumerate(contents, 1))
    return log(b"".join(map(framed, records)))


@functools.cache
def _log_file() -> LogFile:
    folder = scratch() / "motor.log"
    folder.mkdir()
    return new_file(folder, 1, INFO.started, 1)


def _events() -> bytes:
    event = EventRow(INFO.started, 7, "trip", "error", "stale", 5.0, 1)
    batch = msgspec.structs.replace(make_batch([], last=True), events=[event])
    file = write_log(scratch() / "events.log", Header(INFO, ""), batch)
    path = scratch() / "events.good"
    schemas = {str(TableName.EVENTS): table_schema(TableName.EVENTS)}
    write_parquet(lambda _: path, logged_batches([file], schemas, []))
    return path.read_bytes()


def _log() -> bytes:
    batch = make_batch([make_tick(number) for number in range(3)], last=True)
    return write_log(scratch() / "good.log", Header(INFO, ""), batch).path.read_bytes()


def _payloads() -> tuple[bytes, ...]:
    ticks = make_batch([make_tick(0)]).ticks
    left = Recalled(replies=(("a", 1.0, b"{}"),), learnt=b"{}")
    begin = Begin(Header(INFO, ""), 1, left)
    rows = [{"monotonic_s": 1.0, "k": 1}]
    return tuple(msgspec.msgpack.encode(one) for one in (ticks, begin, rows, ("a", b"{}")))


def _ticks() -> bytes:
    path = scratch() / "ticks.good"
    batch = pa.RecordBatch.from_pydict({"sequence": [0, 1], "output": [1.0, 2.0]})
    write_parquet(lambda _: path, [(TableName.TICKS, batch), (TableName.TICKS, batch)])
    return path.read_bytes()


def _checkpoint() -> bytes:
    motor, _, load = _motor()
    values = load.physical(list(load.numerator), list(load.denominator))
    return checkpoint_record(configuration_key(motor), load.names, Learnt(tuple(values), 0.0049))


_SESSION = (
    b'{"drive":"motor","version":"0.1.0","started":"2026-01-01T00:00:00Z","ticks_per_period":120,'
    b'"latency_ticks":2,"line_frequency_Hz":60.0,"ended":"orderly","format":1}'
)

DISKS: dict[str, Target] = {
    "checkpoint": Target(checkpoint, (), (_checkpoint(),), 300, 0.5),
    "session": Target(session, (RecordingError,), (_SESSION,), 200, 0.5),
    "events": Target(events, (RecordingError,), (_events(),), 100, 0.2),
    "table": Target(table, (RecordingError,), (_ticks(),), 100, 0.2),
    "log": Target(log, (), (_log(),), 100, 0.2),
    "payload": Target(payload, (), _payloads(), 100, 0.2),
}
