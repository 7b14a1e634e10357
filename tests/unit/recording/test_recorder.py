"""The recorder in virtual time: what it keeps, what it tells, and what a disk costs it."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import resource
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from adaptdrive.recording import log as log_module
from adaptdrive.recording.archive import archive
from adaptdrive.recording.archiver import EVENT_KIND
from adaptdrive.recording.log_files import log_files
from adaptdrive.recording.reader import Session, read_session, session_notes, verify
from adaptdrive.recording.recorder import Recorder
from adaptdrive.recording.records import Header, Keep, Pace
from adaptdrive.recording.segments import prune
from adaptdrive.recording.session import Dropped, Ending, session_directories
from adaptdrive.runtime.reports import CommandReport, Event, Hub, Severity
from tests.unit.recording.disk import Disk, archive_in_process
from tests.unit.recording.material import INFO, make_tick

NOW = datetime(2026, 11, 21, 1, 30, tzinfo=UTC)
COMMANDED = CommandReport("1", "setpoint", "3.1", "ann", accepted=True, reason="")
FREE = resource.getrlimit(resource.RLIMIT_FSIZE)
ROOMY = 1 << 24
TIGHT = 50_000
"""Backlog that a stalled writer fills within a second."""


def clock() -> tuple[float, float]:
    return asyncio.get_running_loop().time(), NOW.timestamp()


class Bench:
    """A recorder at work, and what a control process would do beside it."""

    def __init__(self, sessions: Path, backlog_bytes: int = ROOMY, flush_s: float = 0.05) -> None:
        self.hub = Hub()
        self.sessions = sessions
        self.published = 0
        self.told = self.hub.subscribe(Event, size=100)
        pace = Pace(flush_s=flush_s, backlog_bytes=backlog_bytes, trip_s=0.5)
        header = Header(INFO, "# as configured\n")
        self.recorder = Recorder(log_of(sessions), sessions, header, self.hub, clock, pace)
        self.running: asyncio.Task[None] | None = None

    @property
    def directory(self) -> Path:
        """Of the session; the folder of all while there is none."""
        return next(session_directories(self.sessions), self.sessions)

    async def publish(self, ticks: int) -> None:
        """Publish ticks; other tasks get their turn as often as in a real process."""
        for _ in range(ticks):
            self.hub.publish(replace(make_tick(self.published), time_s=clock()[0]))
            self.published += 1
            if self.published % 20 == 0:
                await asyncio.sleep(0.02)

    async def publish_until(self, condition: Callable[[], bool]) -> None:
        for _ in range(100):
            if condition():
                return
            await self.publish(100)
        pytest.fail("it does not come about")

    def trip(self, detail: str) -> None:
        self.hub.publish(Event("trip", Severity.ALARM, detail, self.published))

    def session(self) -> Session:
        return read_session(self.directory)

    def said(self) -> list[str]:
        return [event.detail for event in self.told.drain() if isinstance(event, Event)]

    def trips(self) -> list[Path]:
        """Records of trips in the order of their events."""
        found = self.directory.glob("trip-*")
        return sorted(found, key=lambda path: int(path.name.rpartition("-")[2]))

    async def stop(self) -> None:
        assert self.running is not None
        self.running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self.running


def log_of(sessions: Path) -> Path:
    return sessions.with_name("motor.log")


@contextmanager
def full(bench: Bench) -> Iterator[None]:
    """Have the file of the log take 5,000 bytes more."""
    size = log_files(log_of(bench.sessions))[-1].path.stat().st_size
    soft, hard = resource.prlimit(0, resource.RLIMIT_FSIZE, (size + 5000, FREE[1]))
    try:
        yield
    finally:
        resource.prlimit(0, resource.RLIMIT_FSIZE, (soft, hard))


@asynccontextmanager
async def recording(
    sessions: Path, *, backlog_bytes: int = ROOMY, flush_s: float = 0.05
) -> AsyncIterator[Bench]:
    bench = Bench(sessions, backlog_bytes, flush_s)
    with pytest.MonkeyPatch.context() as patch:
        archive_in_process(patch)
        bench.running = asyncio.create_task(bench.recorder.run())
        yield bench
        await bench.stop()


def sequences(session: Session) -> list[int]:
    return [int(number) for number in session.ticks["sequence"].to_pylist()]


@pytest.fixture(autouse=True)
def _prompt(disk: Disk) -> None:
    """All of these recorders write to that disk."""


async def test_an_orderly_end_records_every_tick_up_to_the_last(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish(537)
    read = bench.session()
    assert sequences(read) == list(range(bench.published))
    assert read.info.ended is Ending.ORDERLY
    assert read.info.dropped == Dropped()
    assert read.config_text == "# as configured\n"
    assert (bench.directory / "ticks-0001.parquet").exists()
    assert bench.said() == []


async def test_the_first_archiver_finds_no_log_and_tells_nothing(sessions: Path) -> None:
    """The thread of the log may make its folder later than the archiver looks for it."""
    assert archive(log_of(sessions), 0.0, 10.0, lambda *_: pytest.fail("it tells")) == []


async def test_an_event_during_the_end_is_in_the_session_once(sessions: Path) -> None:
    said = [f"number {index}" for index in range(10_000)]
    waiting = iter(said)

    def act() -> None:
        bench.hub.publish(Event("bus", Severity.INFO, next(waiting), bench.published))
        bench.hub.publish(COMMANDED)

    async with recording(sessions) as bench:
        await bench.publish(500)
        for _ in range(100):
            act()
        ending = asyncio.create_task(bench.stop())
        while not ending.done():
            act()
            await asyncio.sleep(0)
    read = bench.session()
    assert read.info.ended is Ending.ORDERLY
    last = len(read.events)
    assert 100 <= last <= said.index(next(waiting))
    assert [event.detail for event in read.events] == said[:last]
    assert len(read.commands) == last
    assert sequences(read) == list(range(bench.published))
    assert verify(read).whole


async def test_an_event_is_on_disk_before_the_next_flush(sessions: Path) -> None:
    async with recording(sessions, flush_s=1000.0) as bench:
        bench.hub.publish(Event("trip", Severity.ALARM, "over-voltage: 431 V", 77))
        await asyncio.sleep(0.1)
        events, _ = session_notes(bench.directory)
    found = [(one.time, one.tick, one.kind, one.severity, one.detail) for one in events]
    assert found == [(NOW, 77, "trip", "alarm", "over-voltage: 431 V")]


async def test_a_stalled_writer_costs_ticks_which_are_counted(sessions: Path, disk: Disk) -> None:
    """The stall is told once, and an event during it is recorded after it."""
    async with recording(sessions, backlog_bytes=TIGHT) as bench:
        await bench.publish(200)
        with disk.stalled():
            await bench.publish(3000)
            assert bench.recorder.failing
            (stall,) = bench.said()
            bench.trip("stale")
            await bench.publish(5000)
            assert bench.recorder.failing
            assert bench.said() == ["stale"]
        resumed = bench.published
        await bench.publish(1000)
        (counted,) = bench.said()
    read = bench.session()
    dropped = read.info.dropped
    assert read.info.ended is Ending.ORDERLY
    assert dropped.ticks > 1000
    assert read.ticks.num_rows + dropped.ticks == bench.published
    assert sequences(read)[-1] > resumed
    assert "stalled" in stall
    assert counted.startswith("not recorded so far")
    assert [event.detail for event in read.events] == [stall, "stale", counted]


async def test_a_disk_that_takes_nothing_is_named_where_ticks_are_lost(sessions: Path) -> None:
    sessions.write_text("no folder")  # noqa: ASYNC240
    async with recording(sessions, backlog_bytes=TIGHT) as bench:
        await bench.publish(3000)
        assert bench.recorder.failing
        heard = bench.said()
    assert heard[0].startswith("nothing is recorded")
    assert [detail for detail in heard if "stalled" in detail] == []
    assert any("ticks are lost" in detail for detail in heard)


async def test_a_full_disk_stops_recording_which_resumes(sessions: Path) -> None:
    """Meanwhile a person who makes room with `sessions prune` does not take this session."""
    async with recording(sessions) as bench:
        await bench.publish(200)
        assert not bench.recorder.failing
        with full(bench):
            await bench.publish(1000)
            assert bench.recorder.failing
            assert list(prune(sessions, Keep(bytes=1), datetime.now(UTC))) == []
        await bench.publish(100)
        assert not bench.recorder.failing
        first, *_, last = bench.told.drain()
    read = bench.session()
    assert sequences(read) == list(range(bench.published))
    assert read.info.ended is Ending.ORDERLY
    assert isinstance(first, Event)
    assert first.severity is Severity.ALARM
    assert "File too large" in first.detail
    assert isinstance(last, Event)
    assert "recording continues" in last.detail


async def test_a_stop_on_a_disk_without_room_writes_what_waits_and_archives_it(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is left of the disk is for the end: the reserve, or less than its size."""

    def no_room(_: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    async with recording(sessions) as bench:
        await bench.publish(200)
        monkeypatch.setattr(log_module, "set_aside", no_room)
        await bench.publish(500)
        assert bench.recorder.failing
        assert len(sequences(bench.session())) < bench.published
    read = bench.session()
    assert bench.recorder.complete
    assert read.info.ended is Ending.ORDERLY
    assert sequences(read) == list(range(bench.published))
    assert verify(read).whole
    assert (bench.directory / "ticks-0001.parquet").exists()


async def test_nothing_is_made_before_it_may_begin(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive_in_process(monkeypatch)
    bench, begin = Bench(sessions), asyncio.Event()
    bench.running = asyncio.create_task(bench.recorder.run(begin))
    await bench.publish(100)
    assert not sessions.exists()  # noqa: ASYNC240
    begin.set()
    await bench.publish(100)
    await bench.stop()
    assert sequences(bench.session()) == list(range(bench.published))


@pytest.mark.parametrize("recorded_s", [0.0, 0.001, 1.0])
async def test_a_loss_in_the_queue_is_told_in_the_session(
    sessions: Path, monkeypatch: pytest.MonkeyPatch, recorded_s: float
) -> None:
    """Even in one that ends before the losses have been counted the first time."""
    archive_in_process(monkeypatch)
    bench = Bench(sessions)
    for number in range(1500):
        bench.hub.publish(make_tick(number))
    bench.running = asyncio.create_task(bench.recorder.run())
    await asyncio.sleep(recorded_s)
    await bench.stop()
    read = bench.session()
    assert sequences(read) == list(range(500, 1500))
    assert read.info.dropped == Dropped(ticks=500)
    assert [event.kind for event in read.events] == [EVENT_KIND]


async def test_a_loss_during_a_stall_until_the_end_is_told(sessions: Path, disk: Disk) -> None:
    async with recording(sessions, backlog_bytes=TIGHT) as bench:
        await bench.publish(200)
        with disk.stalled():
            await bench.publish(3000)
            assert bench.running is not None
            bench.running.cancel()
            await asyncio.sleep(0.1)  # the last count comes while nothing is written
        await asyncio.wait([bench.running])
    lost = bench.session().info.dropped
    assert lost.ticks > 1000
    assert f"not recorded so far: {lost}" in [one.detail for one in bench.session().events]


def test_the_control_process_never_loads_the_disk_library(outside: None) -> None:
    question = "import sys, adaptdrive.recording.recorder; print('pyarrow' in sys.modules)"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    answer = subprocess.check_output([sys.executable, "-c", question], env=environment)
    assert answer.strip() == b"False"


async def test_trips_one_after_another_and_at_the_end_have_a_record_each(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish(400)
        bench.trip("first")
        await bench.publish(20)
        bench.trip("second")
        await bench.publish_until(lambda: bool(bench.trips()))
        bench.trip("in the queue at the end")
    texts = [(trip / "trip.txt").read_text().splitlines()[0] for trip in bench.trips()]
    assert texts == ["first", "second", "in the queue at the end"]
