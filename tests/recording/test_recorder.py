import asyncio
import contextlib
import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from adaptdrive.errors import RecordingError
from adaptdrive.recording.log_files import log_files
from adaptdrive.recording.log_writer import LogWriter
from adaptdrive.recording.reader import Session, read_session, session_notes
from adaptdrive.recording.recorder import EVENT_KIND, Recorder
from adaptdrive.recording.recorder_settings import Place, RecordingPace
from adaptdrive.recording.records import EventRow, Header, Keep
from adaptdrive.recording.retention import prune
from adaptdrive.recording.session import Dropped, Ending, session_directories
from adaptdrive.recording.verify import verify
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.reports import CommandReport, Event, Severity
from tests.recording.material import INFO, archive_all, fill, make_tick, wait_until

NOW = datetime(2026, 11, 21, 1, 30, tzinfo=UTC)
PATIENCE_S = 120.0
COMMANDED = CommandReport("1", "setpoint", "3.1", "ann", accepted=True, reason="")

FREE = resource.getrlimit(resource.RLIMIT_FSIZE)
ROOMY = 1 << 24
"""Backlog for a writer that is slow on a busy machine: nothing may be dropped."""

TIGHT = 50_000
"""Backlog that a stalled writer fills within a second."""


def clock() -> tuple[float, float]:
    return time.monotonic(), NOW.timestamp()


class Bench:
    """A recorder at work, and what a control process would do beside it."""

    def __init__(
        self, sessions: Path, backlog_bytes: int = ROOMY, close_s: float = PATIENCE_S
    ) -> None:
        self.hub = Hub()
        self.sessions = sessions
        self.published = 0
        self.told = self.hub.subscribe(Event, size=100)
        pace = RecordingPace(flush_s=0.05, backlog_bytes=backlog_bytes, close_s=close_s, trip_s=0.5)
        place, header = Place(log_of(sessions), sessions), Header(INFO, "# as configured\n")
        self.recorder = Recorder(place, header, self.hub, clock, pace)
        self.running: asyncio.Task[None] | None = None

    @property
    def directory(self) -> Path:
        """Of the session; the folder of all while there is none."""
        return next(session_directories(self.sessions), self.sessions)

    async def publish(self, ticks: int) -> None:
        """Publish ticks; other tasks get their turn as often as in a real process."""
        for _ in range(ticks):
            self.hub.publish(replace(make_tick(self.published), time_s=time.monotonic()))
            self.published += 1
            if self.published % 20 == 0:
                await asyncio.sleep(0.002)

    async def publish_until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not condition():
                await self.publish(100)

    async def publish_slowly_until(self, condition: Callable[[], bool]) -> None:
        """Publish about as fast as a drive, as the space that is set aside is measured for."""
        async with asyncio.timeout(PATIENCE_S):
            while not condition():
                await self.publish(20)
                await asyncio.sleep(0.1)

    async def settle(self) -> None:
        """Wait until all that was published is on disk, and the recorder has heard that."""
        async with asyncio.timeout(PATIENCE_S):
            while self.rows() < self.published or self.recorder.failing:  # noqa: ASYNC110  another process writes them
                await asyncio.sleep(0.05)

    def session(self) -> Session:
        return read_session(self.directory)

    def rows(self) -> int:
        return rows(self.directory)

    def said(self) -> list[Event]:
        return [event for event in self.told.drain() if isinstance(event, Event)]

    async def stop(self) -> None:
        assert self.running is not None
        self.running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self.running


@pytest.fixture
def sessions(tmp_path: Path) -> Path:
    return tmp_path / "sessions"


def log_of(sessions: Path) -> Path:
    return sessions.with_name("motor.log")


@contextmanager
def stalled(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Have the disk take nothing meanwhile, and refuse nothing."""
    answers, write = threading.Event(), LogWriter._write

    def hang(writer: LogWriter, content: bytes) -> None:
        answers.wait(PATIENCE_S)
        write(writer, content)

    with monkeypatch.context() as disk:
        disk.setattr(LogWriter, "_write", hang)
        try:
            yield
        finally:
            answers.set()


@contextmanager
def full(bench: "Bench") -> Iterator[None]:
    """Have the file of the log take 5,000 bytes more."""
    size = log_files(log_of(bench.sessions))[-1].path.stat().st_size
    soft, hard = resource.prlimit(0, resource.RLIMIT_FSIZE, (size + 5000, FREE[1]))
    try:
        yield
    finally:
        resource.prlimit(0, resource.RLIMIT_FSIZE, (soft, hard))


@asynccontextmanager
async def recording(
    sessions: Path, *, backlog_bytes: int = ROOMY, close_s: float = 4 * PATIENCE_S
) -> AsyncIterator[Bench]:
    bench = Bench(sessions, backlog_bytes, close_s)
    async with asyncio.TaskGroup() as group:
        bench.running = group.create_task(bench.recorder.run())
        yield bench
        bench.running.cancel()


def sequences(session: Session) -> list[int]:
    return [int(number) for number in session.ticks["sequence"].to_pylist()]


async def test_an_orderly_end_records_every_tick_up_to_the_last(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 500)
        await bench.publish(37)
        await bench.stop()
    read = bench.session()
    assert sequences(read) == list(range(bench.published))
    assert read.info.ended is Ending.ORDERLY
    assert read.info.dropped == Dropped()
    assert read.config_text == "# as configured\n"
    assert (bench.directory / "ticks-0001.parquet").exists()
    assert bench.said() == []


async def test_an_event_during_the_end_is_in_the_session_once(sessions: Path) -> None:
    said = [f"number {index}" for index in range(10_000)]
    waiting = iter(said)
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 500)
        for _ in range(100):
            bench.hub.publish(Event("bus", Severity.INFO, next(waiting), bench.published))
            bench.hub.publish(COMMANDED)
        ending = asyncio.create_task(bench.stop())
        while not ending.done():
            bench.hub.publish(Event("bus", Severity.INFO, next(waiting), bench.published))
            bench.hub.publish(COMMANDED)
            await asyncio.sleep(0.005)
    read = bench.session()
    assert read.info.ended is Ending.ORDERLY
    last = len(read.events)
    assert 100 <= last <= said.index(next(waiting))
    assert [event.detail for event in read.events] == said[:last]
    assert len(read.commands) == last
    assert sequences(read) == list(range(bench.published))
    assert verify(read).whole


async def test_an_event_is_on_disk_before_the_next_flush(sessions: Path) -> None:
    hub = Hub()
    pace = RecordingPace(flush_s=10 * PATIENCE_S, close_s=4 * PATIENCE_S)
    place, header = Place(log_of(sessions), sessions), Header(INFO, "")
    recorder = Recorder(place, header, hub, clock, pace)
    hub.publish(Event("trip", Severity.ALARM, "over-voltage: 431 V", 77))
    async with asyncio.TaskGroup() as group, asyncio.timeout(PATIENCE_S):
        running = group.create_task(recorder.run())
        while not events_on_disk(sessions):  # noqa: ASYNC110  another process writes them
            await asyncio.sleep(0.02)
        running.cancel()
    expected = (NOW.isoformat(), 77, "trip", "alarm", "over-voltage: 431 V")
    assert events_on_disk(sessions) == [expected]


def events_on_disk(sessions: Path) -> list[tuple[str, int, str, str, str]]:
    """What another program sees of the session."""
    found = [one for path in session_directories(sessions) for one in session_notes(path)[0]]
    return [(one.time.isoformat(), one.tick, one.kind, one.severity, one.detail) for one in found]


async def test_a_stalled_writer_costs_ticks_which_are_counted(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with recording(sessions, backlog_bytes=TIGHT) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        heard: list[Event] = []

        def warned() -> bool:
            heard.extend(bench.said())
            return bool(heard)

        with stalled(monkeypatch):
            await bench.publish_until(warned)
            await bench.publish(2000)
        resumed = bench.published
        await bench.publish_until(lambda: warned() and counted(heard))
        await bench.publish_until(lambda: sequences(bench.session())[-1] > resumed)
        await bench.stop()
    read = bench.session()
    dropped = read.info.dropped
    assert read.info.ended is Ending.ORDERLY
    assert dropped.ticks > 1000
    assert read.ticks.num_rows + dropped.ticks == bench.published
    assert sequences(read)[-1] > resumed
    assert "stalled" in heard[0].detail
    assert counted(read.events)


def counted(events: Iterable[Event | EventRow]) -> bool:
    """Whether a loss has been counted; the next stall of so fast a source may come after it."""
    return any("not recorded so far" in event.detail for event in events)


async def test_an_event_during_a_stall_is_recorded_after_it(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with recording(sessions, backlog_bytes=TIGHT) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        with stalled(monkeypatch):
            await bench.publish_until(lambda: bool(bench.said()))
            bench.hub.publish(Event("trip", Severity.ALARM, "stale", bench.published))
            await bench.publish(500)
        await bench.publish_until(lambda: bool(bench.session().events))
        await bench.stop()
    assert [event.detail for event in bench.session().events if event.kind == "trip"] == ["stale"]


async def test_one_stall_is_reported_once_however_long_it_lasts(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with recording(sessions, backlog_bytes=TIGHT) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        with stalled(monkeypatch):
            await bench.publish(5_000)
            at_first, before = bench.recorder.failing, bench.said()
            await bench.publish(20_000)
            still, since = bench.recorder.failing, bench.said()
        await bench.stop()
    assert at_first
    assert still
    assert "stalled" in before[-1].detail
    assert since == []


async def test_a_disk_that_takes_nothing_is_named_where_ticks_are_lost(sessions: Path) -> None:
    await asyncio.to_thread(sessions.touch)  # no folder
    async with recording(sessions, backlog_bytes=TIGHT, close_s=0.1) as bench:
        heard: list[Event] = []

        def lost() -> bool:
            heard.extend(bench.said())
            return any("ticks are lost" in event.detail for event in heard)

        await bench.publish_slowly_until(lambda: bench.recorder.failing)
        await bench.publish_until(lost)
        await bench.stop()
    assert [event.detail for event in heard if "stalled" in event.detail] == []


async def test_a_full_disk_stops_recording_which_resumes(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        heard: list[Event] = []

        def stopped() -> bool:
            heard.extend(bench.said())
            return bool(heard)

        assert not bench.recorder.failing
        with full(bench):
            await bench.publish_until(stopped)
            assert bench.recorder.failing
        await bench.settle()
        assert not bench.recorder.failing
        await bench.stop()
        heard += bench.said()
    read = bench.session()
    assert sequences(read) == list(range(bench.published))
    assert read.info.ended is Ending.ORDERLY
    assert heard[0].severity is Severity.ALARM
    assert "File too large" in heard[0].detail
    assert "recording continues" in heard[-1].detail


async def test_a_session_is_not_pruned_while_a_full_disk_interrupts_it(sessions: Path) -> None:
    """A person makes room with `sessions prune`, which leaves the session in progress alone."""
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        with full(bench):
            await bench.publish_until(lambda: bool(bench.said()))
            for _ in range(20):
                assert list(prune(sessions, Keep(bytes=1), datetime.now(UTC))) == []
                await asyncio.sleep(0.05)
        await bench.settle()
        await bench.stop()
    assert sequences(bench.session()) == list(range(bench.published))
    assert list(prune(sessions, Keep(bytes=1), datetime.now(UTC))) != []


async def test_nothing_is_made_before_it_may_begin(sessions: Path) -> None:
    bench, begin = Bench(sessions), asyncio.Event()
    bench.running = asyncio.create_task(bench.recorder.run(begin))
    await bench.publish(100)
    assert bench.rows() == 0
    assert not sessions.exists()  # noqa: ASYNC240
    begin.set()
    await bench.settle()
    await bench.stop()
    assert sequences(bench.session()) == list(range(bench.published))


async def test_a_loss_in_the_queue_is_told_in_the_session(sessions: Path) -> None:
    bench = Bench(sessions)
    for _ in range(1500):
        bench.hub.publish(make_tick(bench.published))
        bench.published += 1
    async with asyncio.TaskGroup() as group:
        bench.running = group.create_task(bench.recorder.run())
        async with asyncio.timeout(PATIENCE_S):
            while not bench.rows():  # noqa: ASYNC110  another process writes them
                await asyncio.sleep(0.02)
        bench.running.cancel()
    read = bench.session()
    assert sequences(read) == list(range(500, 1500))
    assert read.info.dropped == Dropped(ticks=500)
    assert [event.kind for event in read.events] == [EVENT_KIND]


def test_a_session_whose_control_process_is_killed_is_closed_at_the_next_start(
    tmp_path: Path,
) -> None:
    sessions = tmp_path / "sessions"
    program = Path(__file__).with_name("control_process.py")
    control = subprocess.Popen(
        [sys.executable, program, sessions],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    with control:
        wait_until(lambda: rows(next(session_directories(sessions), sessions)) > 300)
        (directory,) = session_directories(sessions)
        written = rows(directory)
        control.kill()
    before = sequences(read_session(directory))
    (told,) = archive_all(log_of(sessions))
    assert f"session {directory.name} ended without its close" in told
    read = read_session(directory)
    assert read.info.ended is Ending.CUT
    assert read.ticks.num_rows >= written
    assert sequences(read) == before == list(range(read.ticks.num_rows))
    assert (directory / "ticks-0001.parquet").exists()
    assert verify(read).whole
    assert archive_all(log_of(sessions)) == []


def rows(directory: Path) -> int:
    """Rows that can be read by now."""
    try:
        return int(read_session(directory).ticks.num_rows)
    except RecordingError:
        return 0


def test_the_control_process_never_loads_the_disk_library() -> None:
    question = "import sys, adaptdrive.recording.recorder; print('pyarrow' in sys.modules)"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    answer = subprocess.check_output([sys.executable, "-c", question], env=environment)
    assert answer.strip() == b"False"


async def test_a_trip_is_kept_with_the_minute_before_it(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 300)
        bench.hub.publish(Event("trip", Severity.ALARM, "over-voltage: 431 V", bench.published))
        await bench.publish(300)
        await bench.publish_until(
            lambda: any("record of the trip" in event.detail for event in bench.said())
        )
        written = bench.published
        await bench.stop()
    (trip,) = bench.directory.glob("trip-*")
    kept = read_session(trip)
    numbers = sequences(kept)
    assert numbers == list(range(numbers[-1] + 1))
    assert 600 <= len(numbers) <= written
    assert "over-voltage: 431 V" in (trip / "trip.txt").read_text().splitlines()[0]
    assert [event.kind for event in kept.events if event.kind == "trip"] == ["trip"]


async def test_files_named_like_modules_in_the_working_folder_keep_nothing_from_being_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sessions, started = tmp_path / "sessions", tmp_path / "started"
    code = f"open({str(started)!r}, 'a').write('x')\nraise OSError"
    for name in ("inspect", "queue", "random", "select", "statistics", "struct", "matplotlib"):
        (tmp_path / f"{name}.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 300 or started.exists())
        bench.hub.publish(Event("trip", Severity.ALARM, "over-voltage: 431 V", bench.published))
        await bench.publish_until(lambda: bool(trip_texts(bench.directory)) or started.exists())
        await bench.stop()
    assert not started.exists()
    assert sequences(bench.session()) == list(range(bench.published))
    assert trip_texts(bench.directory) == ["over-voltage: 431 V"]


async def test_trips_one_after_another_and_at_the_end_have_a_record_each(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 300)
        bench.hub.publish(Event("trip", Severity.ALARM, "first", bench.published))
        await bench.publish(20)
        bench.hub.publish(Event("trip", Severity.ALARM, "second", bench.published))
        await bench.publish_until(lambda: bool(trip_texts(bench.directory)))
        bench.hub.publish(Event("trip", Severity.ALARM, "in the queue at the end", bench.published))
        await bench.stop()
    assert trip_texts(bench.directory) == ["first", "second", "in the queue at the end"]


def trip_texts(directory: Path) -> list[str]:
    """First line of each record of a trip, which names the trip, in the order of their events."""
    trips = sorted(directory.glob("trip-*"), key=lambda path: int(path.name.rpartition("-")[2]))
    return [(trip / "trip.txt").read_text().splitlines()[0] for trip in trips]


async def test_a_trip_fits_on_a_full_disk(small_disk: Path) -> None:
    sessions = small_disk / "sessions"
    async with recording(sessions) as bench:
        await bench.publish_slowly_until(lambda: bench.rows() > 100)
        fill(small_disk)
        bench.hub.publish(Event("trip", Severity.ALARM, "over-voltage: 431 V", bench.published))
        heard: list[str] = []

        def written() -> bool:
            heard.extend(event.detail for event in bench.said())
            texts = ("the record of the trip is in", "recording has stopped")
            return all(any(text in detail for detail in heard) for text in texts)

        await bench.publish_slowly_until(written)
        (small_disk / "fill").unlink()
        await bench.stop()
    (trip,) = bench.directory.glob("trip-*")
    assert len(sequences(read_session(trip))) > 100
