"""What daemon and recorder had not written when both were killed is written at the next start."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from array import array
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
from pyarrow import parquet as pq

from adaptdrive.recording import streams
from adaptdrive.recording.batches import Batch, Header, News, event_row, framed, read_frames
from adaptdrive.recording.delivery import Delivery
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.repair import repair
from adaptdrive.recording.session import (
    Dropped,
    Ending,
    NewSession,
    SessionLock,
    create_session,
    read_info,
    session_directories,
    write_info,
)
from adaptdrive.recording.spool import Spool, left_spools, spool_path
from adaptdrive.recording.verify import verify
from adaptdrive.recording.writer import record
from adaptdrive.runtime.reports import Event, Severity
from tests.recording.material import INFO, make_batch, make_tick, record_messages, wait_until
from tests.support import Process, children, slow_disk

PATIENCE_S = 120.0
TORN = (b"\x00" * 4096, b"\x05", b"\x08\x00\x00\x00\xc1\xc1", b"\xff\xff\xff\x7f{}")
"""What a power cut can leave at the end of a file."""


@pytest.fixture
def control(tmp_path: Path) -> Iterator[Process]:
    with started(tmp_path, subprocess.DEVNULL) as process:
        yield process


@pytest.fixture
def slow_control(tmp_path: Path) -> Iterator[Process]:
    """A control process whose log can be read, and each of whose writes to a file takes 10 ms."""
    environment = slow_disk(tmp_path, 0.0)
    if environment is None:
        pytest.skip("no C compiler")
    sessions = tmp_path / "sessions"
    with started(sessions, subprocess.PIPE, **environment, SLOW_WRITE_S="0.01") as process:
        yield process


@contextmanager
def started(sessions: Path, log: int, **environment: str) -> Iterator[Process]:
    program = Path(__file__).with_name("control_process.py")
    path = os.pathsep.join(filter(None, sys.path))
    process = subprocess.Popen(
        [sys.executable, program, sessions],
        env={**os.environ, "PYTHONPATH": path, **environment},
        stderr=log,
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def kill(control: Process, recorder: int, sessions: Path) -> None:
    """Kill both, and wait until the session is nobody's."""
    control.kill()
    os.kill(recorder, signal.SIGKILL)
    control.wait()
    directory = next(session_directories(sessions))

    def is_left() -> bool:
        claim = SessionLock.on(directory)
        if claim is not None:
            claim.release()
        return claim is not None

    wait_until(is_left)


def spooled(path: Path) -> list[Batch]:
    """Whole batches in a spool."""
    with path.open("rb") as source:
        return [msgspec.msgpack.decode(one, type=Batch) for one in list(read_frames(source))[1:]]


def newest(spool: Path) -> int:
    """Number of the last batch in a spool, 0 for none."""
    return max((batch.number for batch in spooled(spool)), default=0)


def last_sequence(batches: list[Batch]) -> int:
    numbers = next(batch.ticks["sequence"] for batch in reversed(batches) if batch.tick_rows)
    assert isinstance(numbers, bytes)
    return array("q", numbers)[-1]


def stream(*messages: Header | Batch) -> bytes:
    return b"".join(framed(message) for message in messages)


def next_start(sessions: Path) -> list[str]:
    """Another daemon starts and ends; what it reports."""
    info = msgspec.structs.replace(INFO, started=INFO.started.replace(year=2027))
    source = stream(Header(info, "", str(sessions)), make_batch([], last=True))
    told: list[News] = []
    record(io.BytesIO(source), told.append)
    problems = [news.detail for news in told if news.severity]
    return problems + list(repair(sessions, sessions / "none", INFO.drive, lambda: False))


def recorded(sessions: Path) -> Session:
    return read_session(next(session_directories(sessions)))


def sequences(session: Session) -> list[int]:
    return [int(number) for number in session.ticks["sequence"].to_pylist()]


def test_a_stalled_recorder_and_a_killed_daemon_lose_nothing_that_was_spooled(
    tmp_path: Path, control: Process
) -> None:
    def rows() -> int:
        return sum(read_session(one.parent).ticks.num_rows for one in tmp_path.glob("*/ticks-*"))

    wait_until(lambda: bool(list(tmp_path.glob("*/ticks-*"))) and rows() > 300)
    (recorder,) = children(control.pid)
    os.kill(recorder, signal.SIGSTOP)
    (spool,) = left_spools(tmp_path)
    wait_until(lambda: newest(spool) > 0)
    # what the recorder answered before it stood still may yet empty the file, what comes later not
    known = newest(spool)
    wait_until(lambda: newest(spool) > known + 10)
    kill(control, recorder, sessions=tmp_path)
    held = spooled(spool)
    next_start(tmp_path)
    session = recorded(tmp_path)
    assert session.info.ended is Ending.LOST
    assert sequences(session) == list(range(session.ticks.num_rows))
    assert sequences(session)[-1] == last_sequence(held)
    numbers = [event.number for event in session.events]
    assert numbers == list(range(1, len(numbers) + 1))
    assert numbers[-1] == max(event.number for batch in held for event in batch.events)
    assert not left_spools(tmp_path)


@pytest.mark.parametrize("tail", TORN)
def test_a_spool_that_breaks_off_gives_its_whole_messages(tmp_path: Path, tail: bytes) -> None:
    header = Header(INFO, "# as configured\n", str(tmp_path))
    batches = [make_batch([make_tick(number)]) for number in range(3)]
    path = spool_path(tmp_path, INFO)
    path.write_bytes(stream(header, *batches) + tail)
    reports = next_start(tmp_path)
    session = recorded(tmp_path)
    assert sequences(session) == [0, 1, 2]
    assert session.info.ended is Ending.LOST
    assert session.config_text == "# as configured\n"
    assert any(session.path.name in sentence for sentence in reports)
    assert not left_spools(tmp_path)


@pytest.mark.parametrize("damaged", [0, 1])
def test_whole_messages_behind_a_damaged_one_are_kept_and_told(
    tmp_path: Path, damaged: int
) -> None:
    header = Header(INFO, "", str(tmp_path))
    messages = [framed(make_batch([make_tick(number)])) for number in range(3)]
    messages[damaged] = b"\x02\x00\x00\x00\xc1\xc1"
    path = spool_path(tmp_path, INFO)
    path.write_bytes(framed(header) + b"".join(messages))
    content = path.read_bytes()
    told = next_start(tmp_path)
    kept = path.with_name(f"damaged{path.name}")
    assert kept.read_bytes() == content
    assert any(kept.name in sentence and f"message {damaged + 2}" in sentence for sentence in told)
    assert not left_spools(tmp_path)
    assert sequences(recorded(tmp_path)) == [*range(damaged)]


def test_a_damaged_message_of_a_session_that_was_closed_is_no_loss(tmp_path: Path) -> None:
    directory = create_session(NewSession(tmp_path, INFO, ""))
    header = Header(INFO, "", str(tmp_path), str(directory))
    record_messages(directory, header, make_batch([make_tick(0)], last=True))
    spool_path(tmp_path, INFO).write_bytes(framed(header) + b"\x00" * 4096)
    assert not next_start(tmp_path)
    assert not left_spools(tmp_path)
    assert not list(tmp_path.glob("damaged*"))


def test_an_event_behind_a_close_that_nobody_acknowledged_is_written(tmp_path: Path) -> None:
    """The recorder process was killed once session.json said how the session ended."""
    directory = create_session(NewSession(tmp_path, INFO, ""))
    header = Header(INFO, "", str(tmp_path), str(directory))
    ticks, closing = make_batch([make_tick(0), make_tick(1)]), make_batch([], last=True)
    record_messages(directory, header, ticks, closing)
    late = event_row(Event("bus", Severity.INFO, "late", 1), INFO.started, 50.0, 1)
    after = msgspec.structs.replace(closing, events=[late])
    spool_path(tmp_path, INFO).write_bytes(stream(header, closing, after))
    assert not next_start(tmp_path)
    session = read_session(directory)
    assert [event.detail for event in session.events] == ["late"]
    assert (session.info.ended, session.info.logged) == (Ending.ORDERLY, 1)
    assert sequences(session) == [0, 1]
    assert verify(session).whole
    assert not left_spools(tmp_path)


def test_a_spool_that_a_full_disk_kept_is_written_at_the_start_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the first start there is no room for it, and its session is closed as lost."""

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    directory = create_session(NewSession(tmp_path, INFO, ""))
    header = Header(INFO, "", str(tmp_path), str(directory))
    record_messages(directory, header, make_batch([make_tick(0)]))
    write_info(directory, msgspec.structs.replace(INFO, ended=Ending.OPEN))
    spool_path(tmp_path, INFO).write_bytes(stream(header, make_batch([make_tick(1)])))
    with monkeypatch.context() as disk:
        disk.setattr(streams.StreamWriter, "write", refuse)
        reported = next_start(tmp_path)
    assert any("is left as it is" in sentence for sentence in reported)
    assert read_info(directory).ended is Ending.LOST
    next_start(tmp_path)
    assert sequences(read_session(directory)) == [0, 1]
    assert sum(read_info(directory).histograms["lateness_us"]) == 2
    assert verify(read_session(directory)).whole
    assert not left_spools(tmp_path)


@pytest.mark.parametrize("ended", [Ending.OPEN, Ending.LOST])
def test_a_damaged_or_removed_segment_keeps_no_rest_from_its_session(
    tmp_path: Path, ended: Ending
) -> None:
    """The counts of the segments that are closed stay those of their time."""
    directory = create_session(NewSession(tmp_path, INFO, ""))
    header = Header(INFO, "", str(tmp_path), str(directory))
    for number in range(3):
        record_messages(directory, header, make_batch([make_tick(number)]))
    write_info(directory, msgspec.structs.replace(read_info(directory), ended=ended))
    (directory / "ticks-0001.parquet").write_bytes(b"damaged")
    (directory / "ticks-0002.parquet").unlink()
    spool_path(tmp_path, INFO).write_bytes(stream(header, make_batch([make_tick(3)])))
    next_start(tmp_path)
    assert not left_spools(tmp_path)
    assert read_info(directory).ended is Ending.LOST
    assert sum(read_info(directory).histograms["lateness_us"]) == 4
    assert pq.read_table(directory / "ticks-0004.parquet")["sequence"].to_pylist() == [3]


@pytest.mark.parametrize("left", [b"", b"\xff\xff\xff\xff\x10"], ids=["empty", "torn"])
def test_a_segment_that_was_killed_at_its_begin_has_no_row_written_twice(
    tmp_path: Path, left: bytes
) -> None:
    """The spool still has rows of the segment before it, as the recorder was behind."""
    directory = create_session(NewSession(tmp_path, INFO, ""))
    header = Header(INFO, "", str(tmp_path), str(directory))
    batches = [make_batch([make_tick(number)]) for number in range(3)]
    record_messages(directory, header, *batches[:2])
    write_info(directory, msgspec.structs.replace(read_info(directory), ended=Ending.OPEN))
    (directory / "ticks-0002.arrows").write_bytes(left)
    spool_path(tmp_path, INFO).write_bytes(stream(header, *batches[1:]))
    next_start(tmp_path)
    assert sequences(read_session(directory)) == [0, 1, 2]
    assert sum(read_info(directory).histograms["lateness_us"]) == 3


def test_an_end_that_was_left_to_the_next_start_is_an_orderly_one(tmp_path: Path) -> None:
    directory = create_session(NewSession(tmp_path, INFO, ""))
    last = msgspec.structs.replace(make_batch([make_tick(0)], last=True), dropped=Dropped(77))
    header = Header(INFO, "", str(tmp_path), str(directory))
    spool_path(tmp_path, INFO).write_bytes(stream(header, last))
    reported = next_start(tmp_path)
    assert read_info(directory).ended is Ending.ORDERLY
    assert read_info(directory).dropped == Dropped(77)
    assert not any(directory.name in sentence for sentence in reported)


def test_what_a_lost_session_lacks_is_told(tmp_path: Path) -> None:
    directory = create_session(NewSession(tmp_path, INFO, ""))
    batch = msgspec.structs.replace(make_batch([make_tick(0)]), dropped=Dropped(77))
    header = Header(INFO, "", str(tmp_path), str(directory))
    spool_path(tmp_path, INFO).write_bytes(stream(header, batch))
    next_start(tmp_path)
    assert read_info(directory).ended is Ending.LOST
    assert read_info(directory).dropped == Dropped(77)


@pytest.mark.parametrize(
    "content",
    [
        b"\x02\x00\x00\x00\xc1\xc1",
        stream(Header(INFO, "", "")).replace(b"motor", b"m\xfftor"),  # no UTF-8
    ],
)
def test_a_spool_that_cannot_be_read_is_kept_and_reported_once(
    tmp_path: Path, content: bytes
) -> None:
    path = spool_path(tmp_path, INFO)
    path.write_bytes(content)
    kept = path.with_name(f"damaged{path.name}")
    assert any(str(kept) in sentence for sentence in next_start(tmp_path))
    assert kept.read_bytes() == content
    assert not any(str(kept) in sentence for sentence in next_start(tmp_path))


def test_a_spool_that_another_process_reads_is_left_to_the_next_start(tmp_path: Path) -> None:
    """As when the daemon was restarted at once: its recorder looks at each spool that is left."""
    directory = create_session(NewSession(tmp_path, INFO, ""))
    header = Header(INFO, "", str(tmp_path), str(directory))
    batches = [make_batch([make_tick(number)]) for number in range(2)]
    path = spool_path(tmp_path, INFO)
    path.write_bytes(stream(header, *batches))
    with path.open("rb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        record(io.BytesIO(stream(header, batches[0])), lambda _news: None)
    assert read_info(directory).ended is Ending.OPEN
    next_start(tmp_path)
    assert sequences(read_session(directory)) == [0, 1]


async def test_the_end_waits_for_no_helper_thread(tmp_path: Path) -> None:
    """Each of them waits for a disk that hangs, and the recorder has no folder to write to."""
    (tmp_path / "sessions").write_text("in the way")
    reported: list[tuple[Severity, str]] = []
    header = Header(INFO, "", str(tmp_path / "sessions"))
    delivery = Delivery(header, 1 << 20, lambda *report: reported.append(report))
    delivery.offer(make_batch([make_tick(0)]))
    answers, loop = threading.Event(), asyncio.get_running_loop()
    with ThreadPoolExecutor(1) as pool:
        loop.set_default_executor(pool)
        pool.submit(answers.wait)
        async with asyncio.timeout(PATIENCE_S):
            assert await delivery.finish(Dropped(), 0.5) == Dropped(ticks=1)
        answers.set()
    assert reported[-1][0] is Severity.ALARM
    assert "the end of the session is not recorded" in reported[-1][1]


@pytest.mark.parametrize("make", [os.mkfifo, Path.mkdir], ids=["FIFO", "directory"])
def test_what_is_no_spool_is_left_and_hides_no_other(
    tmp_path: Path, make: Callable[[Path], None]
) -> None:
    make(tmp_path / ".unwritten-20260101T000000000000Z_motor")
    header = Header(INFO, "", str(tmp_path))
    spool_path(tmp_path, INFO).write_bytes(stream(header, make_batch([make_tick(0)])))
    next_start(tmp_path)
    assert sequences(recorded(tmp_path)) == [0]
    assert len(left_spools(tmp_path)) == 1


def test_a_spool_whose_session_cannot_be_read_keeps_no_other_from_being_written(
    tmp_path: Path,
) -> None:
    first = msgspec.structs.replace(INFO, started=INFO.started.replace(year=2025))
    for info in (first, INFO):
        header = Header(info, "", str(tmp_path), str(tmp_path))
        batch = make_batch([make_tick(0)])
        spool_path(tmp_path, info).write_bytes(stream(header, batch))
    blocked = tmp_path / f"{first.started:%Y%m%dT%H%M%SZ}_motor"
    blocked.mkdir()
    write_info(blocked, first)
    (blocked / "ticks-0001.parquet").write_bytes(b"no Parquet")
    told = next_start(tmp_path)
    assert read_session(tmp_path / f"{INFO.started:%Y%m%dT%H%M%SZ}_motor").ticks.num_rows == 1
    assert left_spools(tmp_path) == [spool_path(tmp_path, first)]
    assert any("ticks-0001.parquet" in sentence for sentence in told)


def test_a_spool_of_a_version_with_other_columns_is_written(tmp_path: Path) -> None:
    """Ticks in a version before `mode` and `steady`, and with a column that was given up."""
    batch = make_batch([make_tick(0), make_tick(1)])
    missing = ("mode", "steady")
    kept = {name: values for name, values in batch.ticks.items() if name not in missing}
    older = msgspec.structs.replace(batch, ticks=kept | {"given_up": bytes(16)})
    spool_path(tmp_path, INFO).write_bytes(stream(Header(INFO, "", str(tmp_path)), older))
    next_start(tmp_path)
    ticks = recorded(tmp_path).ticks
    assert ticks["output"].to_pylist() == [3.0, 3.001]
    assert [ticks[name].to_pylist() for name in missing] == [[None, None]] * 2


def test_a_folder_that_was_moved_takes_the_rest_of_its_session(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    directory = create_session(NewSession(old, INFO, ""))
    header = Header(INFO, "", str(old), str(directory))
    spool_path(old, INFO).write_bytes(stream(header, make_batch([make_tick(0)])))
    old.rename(new)
    next_start(new)
    assert sequences(read_session(new / directory.name)) == [0]
    assert not old.exists()


@pytest.mark.parametrize("copied", ["{}-copy", "backup"])
def test_a_copy_of_a_session_does_not_get_the_rest_of_it(copied: str, tmp_path: Path) -> None:
    directory = create_session(NewSession(tmp_path, INFO, ""))
    shutil.copytree(directory, tmp_path / copied.format(directory.name))
    header = Header(INFO, "", str(tmp_path))
    spool_path(tmp_path, INFO).write_bytes(stream(header, make_batch([make_tick(0)])))
    next_start(tmp_path)
    assert sequences(read_session(directory)) == [0]


def test_the_spool_of_a_living_daemon_is_left_alone(tmp_path: Path) -> None:
    spool = Spool(spool_path(tmp_path, INFO))
    spool.append(framed(Header(INFO, "", str(tmp_path))))
    spool.append(framed(make_batch([make_tick(0)])))
    assert spool.flushed(PATIENCE_S)
    next_start(tmp_path)
    assert left_spools(tmp_path) == [spool.path]
    spool.remove()
    wait_until(lambda: not left_spools(tmp_path))


def test_a_disk_that_refuses_the_spool_is_known(tmp_path: Path) -> None:
    (tmp_path / "sessions").write_text("in the way")
    spool = Spool(spool_path(tmp_path / "sessions", INFO))
    spool.append(b"message")
    assert not spool.flushed(PATIENCE_S)


@pytest.mark.parametrize("away", [shutil.rmtree, lambda path: path.rename(path.parent / "moved")])
def test_a_folder_that_was_taken_away_is_known_at_the_end(
    tmp_path: Path, away: Callable[[Path], object]
) -> None:
    spool = Spool(spool_path(tmp_path / "sessions", INFO))
    spool.append(b"message")
    assert spool.flushed(PATIENCE_S)
    away(tmp_path / "sessions")
    assert not spool.flushed(PATIENCE_S)
    spool.clear()
    spool.append(b"again")
    assert spool.flushed(PATIENCE_S)
    assert spool.path.read_bytes() == b"again"
    spool.remove()


def test_a_spool_that_cannot_be_emptied_begins_in_a_new_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    spool = Spool(spool_path(tmp_path, INFO))
    spool.append(b"message")
    assert spool.flushed(PATIENCE_S)
    monkeypatch.setattr(os, "ftruncate", refuse)
    spool.clear()
    spool.append(b"again")
    assert spool.flushed(PATIENCE_S)
    assert spool.path.read_bytes() == b"again"
    spool.remove()


def test_a_spool_that_lacks_a_message_begins_anew_with_all_that_is_unwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    reported: list[tuple[Severity, str]] = []
    header = Header(INFO, "", str(tmp_path))
    delivery = Delivery(header, 1 << 20, lambda *report: reported.append(report))
    spool = delivery._spool
    delivery.offer(make_batch([make_tick(0)]))
    assert spool.flushed(PATIENCE_S)
    with monkeypatch.context() as disk:
        disk.setattr(os, "write", refuse)
        delivery.offer(make_batch([make_tick(1)]))
        assert not spool.flushed(PATIENCE_S)
    delivery.offer(make_batch([make_tick(2)]))
    assert spool.flushed(PATIENCE_S)
    assert [batch.number for batch in spooled(spool.path)] == [1, 2, 3]
    spool.remove()


def test_after_its_folder_was_deleted_a_killed_daemon_loses_nothing_new(
    tmp_path: Path,
) -> None:
    sessions = tmp_path / "sessions"
    with started(sessions, subprocess.DEVNULL) as control:
        wait_until(
            lambda: bool(left_spools(sessions)) and bool(list(session_directories(sessions)))
        )
        sessions.rename(tmp_path / "deleted")  # a folder in use cannot be deleted in one go
        shutil.rmtree(tmp_path / "deleted", ignore_errors=True)
        wait_until(lambda: bool(list(session_directories(sessions))))
        (recorder,) = children(control.pid)
        os.kill(recorder, signal.SIGSTOP)
        held: list[Batch] = []

        def holds_ticks() -> bool:
            spools = [spooled(spool) for spool in left_spools(sessions)]
            longest: list[Batch] = max(spools, key=len, default=[])
            held[:] = longest
            return sum(batch.tick_rows > 0 for batch in held) > 5

        wait_until(holds_ticks)
        kill(control, recorder, sessions)
    next_start(sessions)
    assert sequences(recorded(sessions))[-1] >= last_sequence(held)


@pytest.mark.parametrize("round_", range(3))
@pytest.mark.parametrize("recorder_too", [True, False])
def test_an_event_is_in_the_session_before_it_is_in_the_log(
    tmp_path: Path, slow_control: Process, *, recorder_too: bool, round_: int
) -> None:
    sessions = tmp_path / "sessions"
    log = slow_control.stderr
    assert log is not None
    said = [log.readline() for _ in range(5)]
    wait_until(lambda: bool(children(slow_control.pid)))
    (recorder,) = children(slow_control.pid)
    os.kill(recorder, signal.SIGSTOP)
    said += [log.readline() for _ in range(3 + round_)]
    slow_control.kill()
    slow_control.wait()
    os.kill(recorder, signal.SIGKILL if recorder_too else signal.SIGCONT)
    said += log.read().splitlines(keepends=True)
    logged = [json.loads(line)["event"] for line in said if line.endswith(b"\n")]
    wait_until(lambda: bool(next_start(sessions)) and not left_spools(sessions))
    recorded_ones = map(read_session, session_directories(sessions))
    assert len(logged) >= 8
    assert set(logged) <= {event.detail for one in recorded_ones for event in one.events}


def test_a_recorder_whose_pipe_breaks_off_writes_the_rest_from_the_spool(tmp_path: Path) -> None:
    header = Header(INFO, "", str(tmp_path))
    batches = [
        msgspec.structs.replace(make_batch([make_tick(number)]), number=number + 1)
        for number in range(4)
    ]
    spool_path(tmp_path, INFO).write_bytes(stream(header, *batches))
    record(io.BytesIO(stream(header, *batches[:2])), lambda _: None)
    assert sequences(recorded(tmp_path)) == [0, 1, 2, 3]
    assert recorded(tmp_path).info.ended is Ending.CUT
    assert not left_spools(tmp_path)


async def test_a_disk_that_hangs_is_waited_for_once(tmp_path: Path) -> None:
    hanging = threading.Event()

    def hang() -> None:
        hanging.wait()

    spool = Spool(spool_path(tmp_path, INFO), hang)
    spool.append(b"first")
    await spool.kept(0.01)
    with pytest.raises(StopIteration):  # it does not wait
        spool.kept(PATIENCE_S).send(None)
    hanging.set()
    assert spool.flushed(PATIENCE_S)
    spool.append(b"second")
    await spool.kept(PATIENCE_S)
    assert spool.path.read_bytes() == b"firstsecond"
    spool.remove()


def test_the_log_of_events_of_a_lost_session_is_one_file(tmp_path: Path, control: Process) -> None:
    def events() -> int:
        return sum(len(read_session(one.parent).events) for one in tmp_path.glob("*/events.sqlite"))

    wait_until(lambda: events() > 3)
    (recorder,) = children(control.pid)
    kill(control, recorder, sessions=tmp_path)
    directory = next(session_directories(tmp_path))
    assert (directory / "events.sqlite-wal").exists()
    next_start(tmp_path)
    assert read_info(directory).ended is Ending.LOST
    assert [path.name for path in directory.glob("events*")] == ["events.sqlite"]
    assert events() > 3
