"""Reports to record, and sessions recorded without a process."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec

from adaptdrive.control.signals import Command, Measurement, Mode, Order, Stage
from adaptdrive.recording.archive import archive, close_segment
from adaptdrive.recording.log_files import Begin, LogFile, log_files, new_file
from adaptdrive.recording.records import (
    CommandRow,
    EventRow,
    Header,
    Kind,
    Record,
    Ticks,
    framed,
    packed_ticks,
    slow_row,
)
from adaptdrive.recording.session import (
    INFO_FILE,
    Dropped,
    Ending,
    SessionInfo,
    read_info,
    write_facts,
    write_info,
)
from adaptdrive.runtime.reports import LoadReport, TickReport
from adaptdrive.util.clock import now_s

INFO = SessionInfo(
    drive="motor",
    version="0.1.0",
    started=datetime(2026, 11, 21, 1, 22, 9, tzinfo=UTC),
    ticks_per_period=120,
    latency_ticks=2,
    line_frequency_Hz=60.0,
)

_MEASUREMENT = Measurement(1000, 1 / 120, 280.1, 120.2, 440.3, 3.0)
_ORDER = Order(Stage.RUN, 3.2, Mode.ADAPTIVE, 0.7)


def make_tick(sequence: int) -> TickReport:
    """The tick of that running number."""
    moved = replace(_MEASUREMENT, tick=1000 + sequence, output=3.0 + 1e-3 * sequence)
    return TickReport(
        sequence,
        moved,
        _ORDER,
        -1,
        Command(0.03, 281.5, True),
        12.0,
        350.0,
        time_s=50.0 + sequence / 120,
    )


class Batch(msgspec.Struct, frozen=True):
    """Rows and notes that are logged together."""

    ticks: Ticks
    slow: list[dict[str, Any]] = []
    events: list[EventRow] = []
    dropped: Dropped = Dropped()
    last: bool = False
    utc_offset_s: float = 0.0
    sensors: list[dict[str, float]] = []
    commands: list[CommandRow] = []


def make_batch(
    ticks: Sequence[TickReport], slow: Sequence[LoadReport] = (), *, last: bool = False
) -> Batch:
    """Reports packed as the recorder packs them."""
    return Batch(packed_ticks(ticks), list(map(slow_row, slow)), last=last)


def write_log(folder: Path, header: Header, *batches: Batch, part: int = 1) -> LogFile:
    """Write a file of a log, as the daemon leaves it."""
    folder.mkdir(parents=True, exist_ok=True)
    known = log_files(folder)
    file = new_file(folder, known[-1].number + 1 if known else 1, header.info.started, part)
    begin = msgspec.msgpack.encode(Begin(header, part))
    contents = [(Kind.BEGIN, begin, 0.0), *(one for batch in batches for one in _records(batch))]
    first = 1_000_000 * file.number
    file.path.write_bytes(
        b"".join(
            framed(Record(number, 0.0, offset_s, kind, payload))
            for number, (kind, payload, offset_s) in enumerate(contents, first)
        )
    )
    return file


def _records(batch: Batch) -> Iterator[tuple[Kind, bytes, float]]:
    tables = {Kind.SLOW: batch.slow, Kind.SENSORS: batch.sensors}
    tables[Kind.TICKS] = batch.ticks if batch.ticks.rows else None  # type: ignore[assignment]
    for kind, content in tables.items():
        if content:
            yield kind, zlib.compress(msgspec.msgpack.encode(content), 1), batch.utc_offset_s
    for event in batch.events:
        yield Kind.EVENT, msgspec.msgpack.encode(event), 0.0
    for command in batch.commands:
        yield Kind.COMMAND, msgspec.msgpack.encode(command), 0.0
    yield Kind.DROPPED, msgspec.msgpack.encode(batch.dropped), 0.0
    if batch.last:
        yield Kind.END, b"", 0.0


def record_messages(directory: Path, header: Header, *batches: Batch) -> SessionInfo:
    """Record batches as the next segment of a session, as archiver and log do."""
    if not (directory / INFO_FILE).exists():
        write_facts(directory, header.info, header.config_text)
    info = read_info(directory)
    with TemporaryDirectory() as folder:
        file = write_log(Path(folder), header, *batches, part=info.segments + 1)
        info = close_segment(directory, info, file.part, [file])
    if info.ended is Ending.OPEN:
        info = msgspec.structs.replace(info, ended=Ending.CUT)
        write_info(directory, info)
    return info


def archive_all(folder: Path) -> list[str]:
    """Do to a log what the archiver process does; what it reports."""
    told: list[str] = []
    archive(folder, now_s(), 10.0, lambda _severity, detail: told.append(detail))
    return told
