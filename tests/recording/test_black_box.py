"""The records of trips at the end of a session."""

from __future__ import annotations

import asyncio
import errno
import io
import os
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import pyarrow as pa
import pytest

from adaptdrive.errors import RecordingError
from adaptdrive.recording.batches import EventRow, Header, framed
from adaptdrive.recording.black_box import TRIP, BlackBox
from adaptdrive.recording.black_box_writer import write_trip
from adaptdrive.recording.left_trips import DamagedTripError, leave, left_path, left_trips
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.replay import replay
from adaptdrive.recording.session import (
    NewSession,
    create_session,
    read_info,
    session_directories,
    write_info,
)
from adaptdrive.recording.streams import StreamWriter
from adaptdrive.recording.verify import verify
from adaptdrive.recording.writer_process import WriterProcess
from adaptdrive.runtime.reports import Severity
from tests.recording.material import INFO, make_batch, make_tick
from tests.recording.test_replay import StandIn

PATIENCE_S = 120.0


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


def trips_of(session: Path) -> list[Path]:
    return sorted(session.glob("trip-*"))


async def test_a_trip_that_takes_too_long_at_the_end_is_written_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reports: list[tuple[Severity, str]] = []
    header = Header(INFO, "", str(tmp_path), str(create_session(NewSession(tmp_path, INFO, ""))))

    def box() -> BlackBox:
        told = lambda severity, detail: reports.append((severity, detail))  # noqa: E731
        return BlackBox(header, told, time.monotonic)

    async def hang(*_: object) -> None:
        await asyncio.Event().wait()

    ended = box()
    ended.directory = header.directory
    trips = [EventRow(INFO.started, n, TRIP, "alarm", f"number {n}", 0.0, n) for n in (1, 2)]
    ended.keep(msgspec.structs.replace(make_batch([make_tick(0)]), events=trips))
    with monkeypatch.context() as busy:
        busy.setattr(WriterProcess, "start", hang)
        await ended.finish(2.0)
    assert [severity for severity, _ in reports] == [Severity.WARNING] * 2
    later = "the record of the trip is written at the next start: "
    assert all(said.startswith(later) for _, said in reports)
    reports.clear()
    starting = asyncio.create_task(box().run())
    async with asyncio.timeout(PATIENCE_S):
        while left_trips(tmp_path, INFO.drive):  # noqa: ASYNC110 - a process sets no event
            await asyncio.sleep(0.02)
    starting.cancel()
    await asyncio.wait([starting])
    texts = [(trip / "trip.txt").read_text() for trip in trips_of(Path(header.directory))]
    assert [text.splitlines()[0] for text in texts] == ["number 1", "number 2"]
    assert [severity for severity, _ in reports] == [Severity.INFO] * 2


def test_a_trip_of_another_drive_is_left_to_its_own_daemon(tmp_path: Path) -> None:
    for drive in ("motor", "left_motor"):
        leave(left_path(tmp_path, msgspec.structs.replace(INFO, drive=drive), 3), b"")
    (tmp_path / f"{left_path(tmp_path, INFO, 4).name}.unfinished").touch()
    ((path, number),) = left_trips(tmp_path, "motor")
    assert (path.name.endswith("-3_motor"), number) == (True, 3)


def trip_messages(
    sessions: Path, directory: str = "", first: int = 0, number: int = 1
) -> io.BytesIO:
    """A trip before there is a session, or in one, as the process that writes it is told."""
    trip = EventRow(INFO.started, 1, TRIP, "alarm", "manual", 0.0, number)
    header = Header(INFO, "", str(sessions), directory)
    batches = [make_batch([make_tick(first)]), make_batch([make_tick(first + 1)])]
    batches[1] = msgspec.structs.replace(batches[1], events=[trip])
    return io.BytesIO(b"".join([framed(header), *map(framed, batches)]))


@pytest.mark.parametrize("session_stays", [True, False])
def test_a_trip_goes_where_its_folder_of_sessions_has_been_moved(
    tmp_path: Path, *, session_stays: bool
) -> None:
    """It goes beside the sessions where its own has been removed, and is listed there."""
    before, sessions = tmp_path / "before", tmp_path / "sessions"
    before.mkdir()
    session = create_session(NewSession(before, INFO, ""))
    messages = trip_messages(before, str(session))
    before.rename(sessions)
    if not session_stays:
        shutil.rmtree(sessions / session.name)
    directory = write_trip(messages, 1, sessions)
    assert directory.parent == (sessions / session.name if session_stays else sessions)
    assert not before.exists()
    assert session_stays or list(session_directories(sessions)) == [directory]


def trip_in(sessions: Path, first: int) -> Path:
    """Record a trip in a session, from the tick of a running number on."""
    session = create_session(NewSession(sessions, INFO, ""))
    return write_trip(trip_messages(sessions, str(session), first), 1, sessions)


def claim(directory: Path, first: int | None) -> None:
    """Have `session.json` name another first tick."""
    write_info(directory, msgspec.structs.replace(read_info(directory), first_sequence=first))


@pytest.mark.parametrize("older", [False, True])
def test_the_record_of_a_trip_in_the_middle_of_a_run_is_whole(
    tmp_path: Path, *, older: bool
) -> None:
    directory = trip_in(tmp_path, 1014)
    assert read_info(directory).first_sequence == 1014
    if older:
        claim(directory, None)
    assert verify(read_session(directory)).whole


def test_ticks_that_the_record_of_a_trip_began_with_are_missed(tmp_path: Path) -> None:
    directory = trip_in(tmp_path, 1014)
    claim(directory, 1010)
    assert verify(read_session(directory)).missing_ticks == 4


@pytest.mark.parametrize("older", [False, True])
def test_a_record_in_the_middle_of_a_run_names_the_session_to_replay(
    tmp_path: Path, *, older: bool
) -> None:
    directory = trip_in(tmp_path, 1014)
    if older:
        claim(directory, None)
    words = f"begins at tick 1014 of a run: replay {re.escape(str(directory.parent))}"
    with pytest.raises(RecordingError, match=words):
        replay(read_session(directory), StandIn())


def test_a_record_from_the_first_tick_on_is_replayed(tmp_path: Path) -> None:
    assert replay(read_session(trip_in(tmp_path, 0)), StandIn()).ticks == 2


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
    directory = write_trip(trip_messages(tmp_path), 1, tmp_path)
    assert read_session(directory).ticks.num_rows == 2


def test_trips_of_two_drives_before_their_sessions_do_not_meet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other drive's record is written while this one's is not finished; no disk is full."""
    kept = tmp_path / ".reserve"
    kept.touch()
    other = Header(msgspec.structs.replace(INFO, drive="other"), "", str(tmp_path))
    trip = EventRow(INFO.started, 1, TRIP, "alarm", "other", 0.0, 2)
    batch = msgspec.structs.replace(make_batch([make_tick(5)]), events=[trip])
    write, meetings = StreamWriter.write, [io.BytesIO(framed(other) + framed(batch))]

    def meet(stream: StreamWriter, rows: pa.RecordBatch) -> None:
        write(stream, rows)
        if meetings:
            write_trip(meetings.pop(), 2, tmp_path)

    monkeypatch.setattr(StreamWriter, "write", meet)
    write_trip(trip_messages(tmp_path), 1, tmp_path)
    records = [read_info(directory) for directory in session_directories(tmp_path)]
    assert {info.drive for info in records} == {INFO.drive, "other"}
    assert kept.exists()


def test_a_trip_before_the_session_has_its_place_in_time(tmp_path: Path) -> None:
    directory = write_trip(trip_messages(tmp_path), 1, tmp_path)
    for year in (2025, 2027):
        info = msgspec.structs.replace(INFO, started=INFO.started.replace(year=year))
        create_session(NewSession(tmp_path, info, ""))
    assert list(session_directories(tmp_path))[1] == directory


def contents(folder: Path) -> list[Path]:
    return list(folder.iterdir())


def content_of(path: Path) -> bytes:
    return path.read_bytes()


async def run_until(box: BlackBox, done: Callable[[], bool]) -> None:
    """Run a black box until something is done; it must not end by itself."""
    running = asyncio.create_task(box.run())
    async with asyncio.timeout(PATIENCE_S):
        while not done() and not running.done():  # noqa: ASYNC110 - a process sets no event
            await asyncio.sleep(0.02)
    assert not running.done()
    running.cancel()
    await asyncio.wait([running])


def set_aside_of(path: Path) -> Path:
    return path.with_name(f"damaged{path.name}")


async def test_what_is_no_kept_trip_is_set_aside_and_keeps_no_other_from_being_written(
    tmp_path: Path,
) -> None:
    """A FIFO has no end, and a sparse file may be larger than the memory."""
    fifo, folder, sparse, kept = (left_path(tmp_path, INFO, number) for number in (1, 2, 3, 4))
    os.mkfifo(fifo)
    folder.mkdir()
    with sparse.open("wb") as file:
        file.truncate(1 << 42)
    leave(kept, trip_messages(tmp_path, number=4).getvalue())
    reports: list[str] = []
    told = lambda _severity, detail: reports.append(detail)  # noqa: E731
    await run_until(
        BlackBox(Header(INFO, "", str(tmp_path)), told, time.monotonic), lambda: not kept.exists()
    )
    assert reports[:3] == [
        f"{set_aside_of(path)} was not written as the record of a trip: {flaw}"
        for path, flaw in (
            (fifo, "it is a FIFO, not a file"),
            (folder, "it is a directory, not a file"),
            (sparse, f"it has {1 << 42} bytes"),
        )
    ]
    assert len(trips_of(tmp_path)) == 1


def damaged_messages(sessions: Path, kind: str) -> bytes:
    """What is kept of a trip, as power cuts and failing disks leave it."""
    whole = trip_messages(sessions).getvalue()
    in_message_2 = whole.index(b"tick_rows")
    return {
        "empty": b"",
        "begun": whole[:50],
        "zeros": bytes(len(whole)),
        "cut": whole[:in_message_2],
        "a changed name": whole.replace(b"tick_rows", b"tick_cows", 1),
        "a changed letter": whole.replace(b"tick_rows", b"tick_r\xffws", 1),
        "a changed column": whole.replace(b"monotonic_s", b"monotonic_t"),
    }[kind]


@pytest.mark.parametrize(
    ("kind", "flaw"),
    [
        ("empty", "it is empty, or breaks off in its first message"),
        ("begun", "it is empty, or breaks off in its first message"),
        ("zeros", "its message 1 cannot be decoded"),
        ("cut", "it has no trip of number 1"),
        ("a changed name", "its message 2 cannot be decoded"),
        ("a changed letter", "its message 2 cannot be decoded"),
        ("a changed column", "its rows make no table"),
    ],
)
async def test_a_damaged_trip_is_reported_once_and_set_aside(
    tmp_path: Path, kind: str, flaw: str
) -> None:
    path, content = left_path(tmp_path, INFO, 1), damaged_messages(tmp_path, kind)
    leave(path, content)
    reports: list[tuple[Severity, str]] = []
    box = BlackBox(
        Header(INFO, "", str(tmp_path)),
        lambda severity, detail: reports.append((severity, detail)),
        time.monotonic,
    )
    await run_until(box, lambda: bool(reports))
    said = f"{set_aside_of(path)} was not written as the record of a trip: {flaw}"
    assert reports == [(Severity.WARNING, said)]
    assert contents(tmp_path) == [set_aside_of(path)]
    assert content_of(set_aside_of(path)) == content
    assert left_trips(tmp_path, INFO.drive) == []


def test_a_damaged_trip_gives_no_reserve_away(tmp_path: Path) -> None:
    kept = tmp_path / ".reserve"
    kept.touch()
    messages = io.BytesIO(damaged_messages(tmp_path, "a changed column"))
    with pytest.raises(DamagedTripError):
        write_trip(messages, 1, tmp_path)
    assert contents(tmp_path) == [kept]


async def test_what_a_daemon_that_was_killed_kept_in_part_is_removed_at_the_next_start(
    tmp_path: Path,
) -> None:
    """Another drive's daemon may be keeping a trip at that moment."""
    other = msgspec.structs.replace(INFO, drive="left_motor")
    own, others = (
        tmp_path / f"{left_path(tmp_path, info, 1).name}.unfinished" for info in (INFO, other)
    )
    for path in (own, others):
        path.touch()
    box = BlackBox(Header(INFO, "", str(tmp_path)), lambda *_: None, time.monotonic)
    await run_until(box, lambda: not own.exists())
    assert contents(tmp_path) == [others]


async def test_a_trip_of_this_run_is_written_before_those_of_earlier_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What its record is made of is forgotten after a while; what an earlier run kept stays."""
    earlier = [left_path(tmp_path, INFO, number) for number in (1, 2, 3)]
    for path in earlier:
        leave(path, b"")
    written: list[int] = []
    box = BlackBox(Header(INFO, "", str(tmp_path)), lambda *_: None, time.monotonic, after_s=0.0)
    trip = EventRow(INFO.started, 1, TRIP, "alarm", "manual", 0.0, 9)

    async def write(_: Path, _module: str, number: str, *_words: str) -> WriterProcess:
        written.append(int(number))
        if len(written) == 1:
            box.keep(msgspec.structs.replace(make_batch([make_tick(0)]), events=[trip]))
        raise OSError("no process")

    monkeypatch.setattr(WriterProcess, "start", write)
    await run_until(box, lambda: len(written) == 4)
    assert written == [1, 9, 2, 3]


def test_a_full_disk_keeps_nothing_of_a_trip_that_it_does_not_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file system may say so only when what it was given goes to the disk."""

    def refuse(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OSError, match="No space left"):
        leave(left_path(tmp_path, INFO, 1), b"messages")
    assert contents(tmp_path) == []
