import asyncio
import contextlib
import os
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import pytest

from adaptdrive.errors import RecordingError
from adaptdrive.recording.batches import Batch, EventRow, Header, Keep, News
from adaptdrive.recording.left_trips import left_trips
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.recorder import EVENT_KIND, Clocks, Feed, Recorder, WritePace
from adaptdrive.recording.retention import prune
from adaptdrive.recording.session import Dropped, Ending, read_info, session_directories
from adaptdrive.recording.spool import left_spools
from adaptdrive.recording.verify import verify
from adaptdrive.recording.writer import PatientWriter
from adaptdrive.recording.writer_process import WriterProcess
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.reports import CommandReport, Event, Severity
from tests.recording.material import (
    INFO,
    fill,
    make_batch,
    make_tick,
    record_messages,
    wait_until,
)

NOW = datetime(2026, 11, 21, 1, 30, tzinfo=UTC)
CLOCKS = Clocks(lambda: NOW, time.monotonic)
PATIENCE_S = 120.0
COMMANDED = CommandReport("1", "setpoint", "3.1", "ann", accepted=True, reason="")

FREE = resource.getrlimit(resource.RLIMIT_FSIZE)
ROOMY = 1 << 24
"""Backlog for a writer that is slow on a busy machine: nothing may be dropped."""

UNAVAILABLE_STACK_BYTES = 1 << 46
"""A stack for which no machine has the addresses: no thread starts with it."""

TIGHT = 50_000
"""Backlog that a stalled writer fills within a second."""


class Bench:
    """A recorder at work, and what a control process would do beside it."""

    def __init__(
        self, sessions: Path, backlog_bytes: int = ROOMY, close_s: float = PATIENCE_S
    ) -> None:
        self.hub = Hub()
        self.sessions = sessions
        self.published = 0
        self.feed = Feed.of(self.hub, flush_s=0.05)
        self.told = self.hub.subscribe(Event, size=100)
        pace = WritePace(flush_s=0.05, backlog_bytes=backlog_bytes, close_s=close_s, trip_s=0.5)
        header = Header(INFO, "# as configured\n", str(sessions))
        self.recorder = Recorder(header, self.feed, self.hub.publish, CLOCKS, pace)
        self.running: asyncio.Task[None] | None = None

    @property
    def directory(self) -> Path:
        """Of the session; the folder of all while there is none."""
        return next(session_directories(self.sessions), self.sessions)

    async def publish(self, ticks: int) -> None:
        """Publish ticks; other tasks get their turn as often as in a real process."""
        for _ in range(ticks):
            self.hub.publish(make_tick(self.published))
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

    def writer(self) -> int:
        """Process id of the recorder process."""
        found = processes_of(self.sessions, b"recording.writer")
        assert found, "no recorder process"
        return found[0]

    def kill_in_close(self) -> None:
        """Kill the recorder process, if there is one, once it has closed its streams."""
        with contextlib.suppress(AssertionError, OSError):
            recorder = self.writer()
            opened = [one.readlink().suffix for one in Path(f"/proc/{recorder}/fd").iterdir()]
            if ".arrows" not in opened:
                os.kill(recorder, signal.SIGKILL)

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
        ending = asyncio.create_task(bench.stop())
        while not ending.done():
            bench.hub.publish(Event("bus", Severity.INFO, next(waiting), bench.published))
            bench.hub.publish(COMMANDED)
            await asyncio.sleep(0.005)
    await bench.recorder.add_late()
    read = bench.session()
    assert read.info.ended is Ending.ORDERLY
    last = said.index(next(waiting))
    assert [event.detail for event in read.events] == said[:last]
    assert len(read.commands) == last
    assert sequences(read) == list(range(bench.published))
    assert verify(read).whole


async def test_a_session_that_never_began_takes_no_late_event(sessions: Path) -> None:
    bench = Bench(sessions)
    bench.running = asyncio.create_task(bench.recorder.run(asyncio.Event()))
    bench.hub.publish(COMMANDED)
    await asyncio.sleep(0)
    await bench.stop()
    await bench.recorder.add_late()
    assert not sessions.exists()  # noqa: ASYNC240


async def test_an_event_is_on_disk_before_the_next_flush(sessions: Path) -> None:
    hub = Hub()
    pace = WritePace(flush_s=10 * PATIENCE_S, close_s=4 * PATIENCE_S)
    header = Header(INFO, "", str(sessions))
    recorder = Recorder(header, Feed.of(hub, 1.0), hub.publish, CLOCKS, pace)
    hub.publish(Event("trip", Severity.ALARM, "over-voltage: 431 V", 77))
    async with asyncio.TaskGroup() as group, asyncio.timeout(PATIENCE_S):
        running = group.create_task(recorder.run())
        while not events_on_disk(sessions):  # noqa: ASYNC110  another process writes them
            await asyncio.sleep(0.02)
        running.cancel()
    expected = (NOW.isoformat(), 77, "trip", "alarm", "over-voltage: 431 V")
    assert events_on_disk(sessions) == [expected]


def events_on_disk(sessions: Path) -> list[tuple[str, int, str, str, str]]:
    """What another program sees in the event log."""
    path = next(sessions.glob("*/events.sqlite"), sessions / "absent")
    query = "SELECT time, tick, kind, severity, detail FROM events"
    try:
        with contextlib.closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as database:
            return database.execute(query).fetchall()
    except sqlite3.OperationalError:
        return []


async def test_a_killed_writer_is_replaced_and_loses_nothing(sessions: Path) -> None:
    async with recording(sessions) as bench:
        for round_ in range(3):
            await bench.publish(500)
            await bench.settle()
            bench.hub.publish(Event("trip", Severity.ALARM, f"number {round_}", 0))
            os.kill(bench.writer(), signal.SIGKILL)
            await bench.publish(500)
        await bench.settle()
        await bench.stop()
    read = bench.session()
    assert sequences(read) == list(range(bench.published))
    assert read.info.ended is Ending.ORDERLY
    assert read.info.dropped == Dropped()
    assert sum(read.info.histograms["lateness_us"]) == bench.published
    trips = [event.detail for event in read.events if event.kind == "trip"]
    assert trips == ["number 0", "number 1", "number 2"]
    alarms = [event for event in bench.said() if event.severity is Severity.ALARM]
    assert len([event for event in alarms if event.kind == EVENT_KIND]) == 3
    assert any("-9" in event.detail for event in alarms)


async def test_without_a_further_thread_it_says_so_and_records_later(sessions: Path) -> None:
    heard: list[Event] = []

    def failed() -> bool:
        heard.extend(bench.said())
        return any("can't start new thread" in event.detail for event in heard)

    usual = threading.stack_size(UNAVAILABLE_STACK_BYTES)
    try:
        async with recording(sessions) as bench:
            await bench.publish_until(failed)
            threading.stack_size(usual)
            await bench.settle()
            await bench.stop()
    finally:
        threading.stack_size(usual)
    assert sequences(bench.session()) == list(range(bench.published))
    assert bench.session().info.ended is Ending.ORDERLY


async def test_a_process_whose_end_no_thread_can_wait_for_is_ended(sessions: Path) -> None:
    usual = threading.stack_size(UNAVAILABLE_STACK_BYTES)
    try:
        with pytest.raises(OSError, match="can't start new thread"):
            await WriterProcess.start(sessions)
    finally:
        threading.stack_size(usual)
    assert processes_of(sessions, b"recording.writer") == []


async def test_a_stalled_writer_costs_ticks_which_are_counted(sessions: Path) -> None:
    async with recording(sessions, backlog_bytes=TIGHT) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        writer = bench.writer()
        os.kill(writer, signal.SIGSTOP)
        heard: list[Event] = []

        def warned() -> bool:
            heard.extend(bench.said())
            return bool(heard)

        try:
            await bench.publish_until(warned)
            await bench.publish(2000)
        finally:
            os.kill(writer, signal.SIGCONT)
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


async def test_an_event_during_a_stall_is_recorded_after_it(sessions: Path) -> None:
    async with recording(sessions, backlog_bytes=TIGHT) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        writer = bench.writer()
        os.kill(writer, signal.SIGSTOP)
        try:
            await bench.publish_until(lambda: bool(bench.said()))
            bench.hub.publish(Event("trip", Severity.ALARM, "stale", bench.published))
            await bench.publish(500)
        finally:
            os.kill(writer, signal.SIGCONT)
        await bench.publish_until(lambda: bool(bench.session().events))
        await bench.stop()
    assert [event.detail for event in bench.session().events if event.kind == "trip"] == ["stale"]


async def test_one_stall_is_reported_once_however_long_it_lasts(sessions: Path) -> None:
    async with recording(sessions, backlog_bytes=TIGHT) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        writer = bench.writer()
        os.kill(writer, signal.SIGSTOP)
        try:
            await bench.publish(5_000)  # what the writer had answered before is heard
            stalled, before = bench.recorder.failing, bench.said()
            await bench.publish(20_000)
            still, since = bench.recorder.failing, bench.said()
        finally:
            os.kill(writer, signal.SIGCONT)
        await bench.stop()
    assert stalled
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


async def test_a_full_disk_stops_recording_which_resumes_in_a_new_segment(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        writer = bench.writer()
        size = (bench.directory / "ticks-0001.arrows").stat().st_size
        _, hard = resource.prlimit(writer, resource.RLIMIT_FSIZE, (size + 5000, FREE[1]))
        heard: list[Event] = []

        def stopped() -> bool:
            heard.extend(bench.said())
            return bool(heard)

        assert not bench.recorder.failing
        await bench.publish_until(stopped)
        assert bench.recorder.failing
        resource.prlimit(writer, resource.RLIMIT_FSIZE, (FREE[0], hard))
        await bench.settle()
        assert not bench.recorder.failing
        await bench.stop()
        heard += bench.said()
    read = bench.session()
    assert sequences(read) == list(range(bench.published))
    assert read.info.ended is Ending.ORDERLY
    assert heard[0].severity is Severity.ALARM
    assert "File too large" in heard[0].detail
    assert "recording goes on in segment" in heard[-1].detail
    assert (bench.directory / "ticks-0001.parquet").exists()
    assert (bench.directory / "ticks-0002.parquet").exists()


async def test_a_session_is_not_pruned_while_a_full_disk_interrupts_it(sessions: Path) -> None:
    """A person makes room with `sessions prune`, which leaves the session in progress alone."""
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        writer = bench.writer()
        size = (bench.directory / "ticks-0001.arrows").stat().st_size
        _, hard = resource.prlimit(writer, resource.RLIMIT_FSIZE, (size + 5000, FREE[1]))
        await bench.publish_until(lambda: bool(bench.said()))
        for _ in range(20):
            assert list(prune(sessions, Keep(bytes=1), datetime.now(UTC))) == []
            await asyncio.sleep(0.05)
        resource.prlimit(writer, resource.RLIMIT_FSIZE, (FREE[0], hard))
        await bench.settle()
        await bench.stop()
    assert sequences(bench.session()) == list(range(bench.published))
    assert list(prune(sessions, Keep(bytes=1), datetime.now(UTC))) != []


async def test_a_removed_session_is_told_and_a_new_one_begins(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        shutil.rmtree(sessions)
        heard: list[Event] = []

        def resumed() -> bool:
            heard.extend(bench.said())
            return any("recording goes on in segment" in event.detail for event in heard)

        await bench.publish_until(resumed)
        first = bench.published
        await bench.publish(200)
        await bench.stop()
    assert "recording has stopped" in heard[0].detail
    assert heard[0].severity is Severity.ALARM
    read = bench.session()
    assert sequences(read)[-200:] == list(range(first, first + 200))
    assert read.info.ended is Ending.ORDERLY


@pytest.mark.parametrize("name", ["ticks-0001.arrows", "events.sqlite"])
def test_a_removed_file_of_a_session_is_told_and_another_begins(name: str, tmp_path: Path) -> None:
    news: list[News] = []
    writer = PatientWriter(Header(INFO, "", str(tmp_path)), news.append, pause_s=0.01)

    def batch(number: int) -> Batch:
        event = EventRow(INFO.started, number, "trip", "alarm", f"{number}", 1.0, number)
        return msgspec.structs.replace(make_batch([make_tick(number)]), events=[event])

    writer.write(batch(1))
    (directory,) = session_directories(tmp_path)
    (directory / name).unlink()
    writer.write(batch(2))
    writer.close(Ending.ORDERLY, Dropped())
    writer.finish()
    assert any(one.failing and name in one.detail for one in news)
    read = read_session(directory)
    assert sequences(read)[-1] == 2
    assert [event.detail for event in read.events][-1] == "2"


async def test_an_end_with_a_full_disk_is_told_and_counted(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 100)
        limit = (6000, FREE[1])  # enough for session.json alone
        resource.prlimit(bench.writer(), resource.RLIMIT_FSIZE, limit)
        await bench.publish_until(lambda: bool(bench.said()))
        bench.hub.publish(Event("trip", Severity.ALARM, "stale", bench.published))
        bench.hub.publish(COMMANDED)
        own = resource.prlimit(0, resource.RLIMIT_FSIZE, limit)  # of processes started from now on
        try:
            await bench.stop()
        finally:
            resource.prlimit(0, resource.RLIMIT_FSIZE, own)
    read = bench.session()
    assert not bench.recorder.complete
    assert any("the end of the session is not recorded" in event.detail for event in bench.said())
    assert read.info.ended is Ending.ORDERLY
    assert read.info.dropped.ticks == bench.published - read.ticks.num_rows > 0
    assert read.info.dropped.events > 0
    assert read.info.dropped.commands == 1


async def test_an_end_with_a_stopped_writer_is_recorded_by_another(sessions: Path) -> None:
    async with recording(sessions, close_s=24.0) as bench:
        await bench.publish(200)
        await bench.settle()
        os.kill(bench.writer(), signal.SIGSTOP)
        await bench.publish(500)
        await bench.stop()
    read = bench.session()
    assert bench.recorder.complete
    assert sequences(read) == list(range(bench.published))
    assert read.info.ended is Ending.ORDERLY


async def test_an_end_whose_recorder_is_killed_in_the_close_is_left_to_the_next_start(
    sessions: Path,
) -> None:
    """As on a slow disk; here the new `session.json` is a FIFO, which holds up its writer."""
    async with recording(sessions) as bench:
        await bench.publish(200)
        bench.hub.publish(COMMANDED)
        await bench.settle()
        blocked = bench.directory / "session.json.unfinished"
        os.mkfifo(blocked)
        ending = asyncio.create_task(bench.stop())
        while not ending.done():
            bench.kill_in_close()
            await asyncio.sleep(0.05)
        blocked.unlink()
    await bench.recorder.add_late()
    (warning,) = bench.said()
    assert "records the end of the session, 0 ticks, 0 slow steps, 0 events" in warning.detail
    assert bench.session().info.ended is Ending.OPEN
    (left,) = left_spools(sessions)  # locked while this process lives
    shutil.copy(left, sessions / "copy")
    (sessions / "copy").rename(left)
    later = msgspec.structs.replace(INFO, started=INFO.started + timedelta(days=1))
    header = Header(later, "", str(sessions))
    told = record_messages(sessions / "later", header, make_batch([], last=True))
    read = bench.session()
    assert [news.detail for news in told if news.detail] == []
    assert read.info.ended is Ending.ORDERLY
    assert [event.detail for event in read.events] == [warning.detail]
    assert read.info.logged == 2
    assert sequences(read) == list(range(bench.published))


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


def test_a_session_whose_control_process_is_killed_closes_itself(tmp_path: Path) -> None:
    program = Path(__file__).with_name("control_process.py")
    control = subprocess.Popen(
        [sys.executable, program, tmp_path],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    with control:
        wait_until(lambda: rows(next(session_directories(tmp_path), tmp_path)) > 300)
        (directory,) = session_directories(tmp_path)
        written = rows(directory)
        control.kill()
    wait_until(lambda: read_info(directory).ended is not Ending.OPEN)
    wait_until((directory / "ticks-0001.parquet").exists)
    read = read_session(directory)
    assert read.info.ended is Ending.CUT
    assert read.ticks.num_rows >= written
    assert sequences(read) == list(range(read.ticks.num_rows))


def rows(directory: Path) -> int:
    """Rows that can be read by now."""
    try:
        return int(read_session(directory).ticks.num_rows)
    except RecordingError:
        return 0


async def test_terminal_and_service_manager_signals_do_not_end_the_writer(
    sessions: Path,
) -> None:
    async with recording(sessions) as bench:
        await bench.publish(200)
        await bench.settle()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGABRT):
            os.kill(bench.writer(), number)
        await bench.publish(500)
        await bench.stop()
    assert sequences(bench.session()) == list(range(bench.published))


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
        await bench.publish_until(lambda: bool(trip_writers(sessions)) or started.exists())
        await bench.stop()
    assert not started.exists()
    assert sequences(bench.session()) == list(range(bench.published))
    assert trip_texts(bench.directory) == ["over-voltage: 431 V"]


async def test_an_end_while_a_trip_is_written_loses_no_record(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 300)
        bench.hub.publish(Event("trip", Severity.ALARM, "over-voltage: 431 V", bench.published))
        await bench.publish_until(lambda: bool(trip_writers(sessions)))
        os.kill(trip_writers(sessions)[0], signal.SIGSTOP)
        await bench.stop()
    assert trip_texts(bench.directory) == ["over-voltage: 431 V"]
    assert any("record of the trip is in" in event.detail for event in bench.session().events)
    assert left_trips(sessions, bench.session().info.drive) == []


async def test_trips_one_after_another_and_at_the_end_have_a_record_each(sessions: Path) -> None:
    async with recording(sessions) as bench:
        await bench.publish_until(lambda: bench.rows() > 300)
        bench.hub.publish(Event("trip", Severity.ALARM, "first", bench.published))
        await bench.publish(20)
        bench.hub.publish(Event("trip", Severity.ALARM, "second", bench.published))
        await bench.publish_until(lambda: bool(trip_writers(sessions)))
        bench.hub.publish(Event("trip", Severity.ALARM, "in the queue at the end", bench.published))
        await bench.stop()
    assert trip_texts(bench.directory) == ["first", "second", "in the queue at the end"]


def trip_writers(sessions: Path) -> list[int]:
    """Process ids of those that write the record of a trip."""
    return processes_of(sessions, b"black_box")


def processes_of(sessions: Path, module: bytes) -> list[int]:
    """Process ids of those that write sessions, by a part of the name of their module."""
    found = []
    for process in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            words = process.read_bytes().split(b"\0")
            if os.fsencode(sessions) in words and any(module in word for word in words):
                found.append(int(process.parent.name))
    return found


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
