"""The records of trips at the end of a session."""

from __future__ import annotations

import errno
import io
from pathlib import Path

import msgspec
import pyarrow as pa
import pytest

from adaptdrive.recording.batches import EventRow, Header, framed
from adaptdrive.recording.black_box import TRIP, BlackBox
from adaptdrive.recording.black_box_writer import write_trip
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.session import NewSession, create_session, session_directories
from adaptdrive.recording.streams import StreamWriter
from adaptdrive.runtime.reports import Severity
from tests.recording.material import INFO, make_batch, make_tick


@pytest.mark.parametrize("timeout_s", [0.0, -1.0])
async def test_a_trip_for_which_no_time_is_left_is_reported_as_such(
    tmp_path: Path, timeout_s: float
) -> None:
    reports: list[tuple[Severity, str]] = []
    box = BlackBox(
        Header(INFO, "", str(tmp_path)),
        lambda severity, detail: reports.append((severity, detail)),
        lambda: 100.0,
    )
    trip = EventRow(INFO.started, 1, TRIP, "alarm", "manual", 0.0, 1)
    box.keep(msgspec.structs.replace(make_batch([make_tick(0)]), events=[trip]))
    await box.finish(timeout_s)
    words = "the record of the trip is not written: no time was left"
    assert reports == [(Severity.ALARM, words)]


def trip_messages(sessions: Path) -> io.BytesIO:
    """A trip before there is a session, as it is passed to the process that writes it."""
    trip = EventRow(INFO.started, 1, TRIP, "alarm", "manual", 0.0, 1)
    batch = msgspec.structs.replace(make_batch([make_tick(0)]), events=[trip])
    return io.BytesIO(framed(Header(INFO, "", str(sessions))) + framed(batch))


def test_a_trip_before_the_session_uses_the_reserve(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full until the reserve is given back."""
    kept = tmp_path / ".reserve"
    kept.write_bytes(bytes(4096))
    write = StreamWriter.write

    def write_if_free(stream: StreamWriter, batch: pa.RecordBatch) -> None:
        if kept.exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        write(stream, batch)

    monkeypatch.setattr(StreamWriter, "write", write_if_free)
    directory = write_trip(trip_messages(tmp_path), 1)
    assert read_session(directory).ticks.num_rows == 1


def test_a_trip_before_the_session_has_its_place_in_time(tmp_path: Path) -> None:
    directory = write_trip(trip_messages(tmp_path), 1)
    for year in (2025, 2027):
        info = msgspec.structs.replace(INFO, started=INFO.started.replace(year=year))
        create_session(NewSession(tmp_path, info, ""))
    assert list(session_directories(tmp_path))[1] == directory
