"""Reports to record, and sessions recorded without a process."""

from __future__ import annotations

import contextlib
import io
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from adaptdrive.control.signals import Command, Measurement, Mode, Order, Stage
from adaptdrive.recording.batches import Batch, Header, News, TickTable, framed, slow_row
from adaptdrive.recording.session import Dropped, SessionInfo
from adaptdrive.recording.writer import record
from adaptdrive.runtime.reports import LoadReport, TickReport

PATIENCE_S = 120.0

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


def make_batch(
    ticks: Sequence[TickReport], slow: Sequence[LoadReport] = (), *, last: bool = False
) -> Batch:
    """Reports packed as the recorder packs them."""
    table = TickTable()
    table.extend(ticks)
    return Batch(table.rows, table.packed(), list(map(slow_row, slow)), [], Dropped(), last)


def record_messages(directory: Path, header: Header, *batches: Batch) -> list[News]:
    """Do to messages what the recorder process does; what it reports."""
    told: list[News] = []
    header = msgspec.structs.replace(header, directory=str(directory))
    record(io.BytesIO(framed(header) + b"".join(map(framed, batches))), told.append)
    return told


def fill(disk: Path) -> None:
    """Leave no room on a disk."""
    descriptor = os.open(disk / "fill", os.O_CREAT | os.O_WRONLY | os.O_APPEND)
    with contextlib.suppress(OSError):
        while True:
            os.write(descriptor, bytes(4096))
    os.close(descriptor)


def wait_until(condition: Callable[[], bool]) -> None:
    """Wait for what another thread or process does."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)
