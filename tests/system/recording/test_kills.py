"""Processes that are killed or that a full disk meets: the control process and the archiver."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from adaptdrive.recording.reader import Session, read_session, verify
from adaptdrive.recording.recorder import Recorder
from adaptdrive.recording.records import Header, Pace
from adaptdrive.recording.session import Ending, session_directories
from adaptdrive.runtime.reports import Event, Hub, Severity
from tests.support import Process, sample, slow_disk
from tests.unit.recording.material import INFO, archive_all, make_batch, make_tick, write_log
from tests.unit.recording.test_archive import Place as Archived
from tests.unit.recording.test_archive import fingerprint, sequences, trip_in, trips_of

pytestmark = pytest.mark.usefixtures("outside")

PATIENCE_S = 120.0


@contextmanager
def started(sessions: Path, **environment: str) -> Iterator[Process]:
    program = Path(__file__).with_name("control_process.py")
    process = subprocess.Popen(
        [sys.executable, program, sessions],
        env=with_path(**environment),
        stderr=subprocess.PIPE,
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def with_path(**environment: str) -> dict[str, str]:
    path = os.pathsep.join(filter(None, sys.path))
    return {**os.environ, "PYTHONPATH": path, **environment}


def killed(process: Process, lines: int) -> list[str]:
    """Kill a process after so many lines of its log; its events there."""
    log = process.stderr
    assert log is not None
    said = [log.readline() for _ in range(lines)]
    process.kill()
    said += log.read().splitlines(keepends=True)
    process.wait()
    return [json.loads(line)["event"] for line in said if line.endswith(b"\n")]


def session_of(sessions: Path) -> Session:
    return read_session(next(session_directories(sessions)))


def wait_until(condition: Callable[[], bool]) -> None:
    """Wait for what another thread or process does."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize("round_", sample(range(6), 1))
def test_a_session_whose_control_process_is_killed_is_closed_at_the_next_start(
    tmp_path: Path, round_: int
) -> None:
    """An event is in it before it is in the log; a write takes 10 ms, and a sync 50 ms."""
    environment = slow_disk(tmp_path, 0.05)
    if environment is None:
        pytest.skip("no C compiler")
    sessions = tmp_path / "sessions"
    with started(sessions, **environment, SLOW_WRITE_S="0.01") as process:
        logged = killed(process, 5 + 3 * round_)
    recorded = {event.detail for event in session_of(sessions).events}
    before = sequences(session_of(sessions))
    assert len(logged) >= 5 + 3 * round_
    assert set(logged) <= recorded
    (told,) = archive_all(sessions.with_name("motor.log"))
    read = session_of(sessions)
    assert f"session {next(session_directories(sessions)).name} ended without its close" in told
    assert {event.detail for event in read.events} == recorded
    assert read.info.ended is Ending.CUT
    assert sequences(read) == before == list(range(read.ticks.num_rows))
    assert verify(read).whole
    assert archive_all(sessions.with_name("motor.log")) == []


# -- the archiver ------------------------------------------------------------------------------


def run_archiver(place: Archived) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "adaptdrive.recording.archiver", str(place.log), "10"]
    return subprocess.Popen(command, env=with_path(), stdout=subprocess.DEVNULL)


@pytest.mark.proof
def test_an_archiver_that_is_killed_anywhere_gives_the_same_session_when_run_again(
    tmp_path: Path,
) -> None:
    place = Archived(tmp_path)
    place.begin()
    for part in range(1, 7):
        place.write(10 * (part - 1), part=part, last=part == 6)
    copies = [place.log.parent / f"copy-{number}" for number in range(8)]
    for copy in copies:
        copy.mkdir()
        for folder in (place.log, place.sessions):
            shutil.copytree(folder, copy / folder.name)
    began_s = time.monotonic()
    run_archiver(place).wait()
    whole_s, whole = time.monotonic() - began_s, fingerprint(place.sessions)
    for number, copy in enumerate(copies, 1):
        other = Archived(copy)
        stopped = run_archiver(other)
        time.sleep(whole_s * (0.3 + 0.7 * number / len(copies)))
        stopped.send_signal(signal.SIGKILL)
        stopped.wait()
        archive_all(other.log)
        assert fingerprint(other.sessions) == whole
        assert [one.number for one in other.session.events] == [1, 11, 21, 31, 41, 51]


@pytest.mark.proof
def test_the_archiver_outlives_signals_that_end_the_daemon(tmp_path: Path) -> None:
    place = Archived(tmp_path)
    place.begin()
    trip_in(place, ticks=50_000)
    archiver = run_archiver(place)
    wait_until(lambda: bool(list(place.sessions.glob("*/.trip-*"))) or bool(trips_of(place)))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGABRT):
        archiver.send_signal(number)
    assert archiver.wait() == 0
    assert verify(place.session).whole


ARCHIVER = """
import sys
from adaptdrive.recording import archiver
archiver.main()
lines = open("/proc/self/status").read().splitlines()
print(next(line for line in lines if line.startswith("VmHWM")).split()[1])
print([name for name in ("numpy", "pandas", "pyarrow.compute") if name in sys.modules])
"""


@pytest.mark.proof
def test_an_archiver_takes_the_memory_of_minutes(tmp_path: Path) -> None:
    """Ten minutes of ticks; an hour takes as much, to be held by 90 MiB with the log's threads."""
    place = Archived(tmp_path)
    place.begin()
    for part in range(3):
        batches = [
            make_batch([make_tick(first + number) for number in range(30)])
            for first in range(24_000 * part, 24_000 * (part + 1), 30)
        ]
        write_log(place.log, place.header(), *batches)
    command = [sys.executable, "-c", ARCHIVER, str(place.log), "10"]
    answer = subprocess.check_output(command, env=with_path(), text=True).splitlines()
    assert place.session.ticks.num_rows == 72_000
    assert answer[-1] == "[]"
    assert int(answer[-2]) / 1024 < 88.0


# -- a recorder with an archiver of its own ------------------------------------------------------


def fill(file: Path) -> None:
    """Leave no room on a disk."""
    with file.open("wb", 0) as content, contextlib.suppress(OSError):
        while True:
            content.write(bytes(4096))


async def record_trip(sessions: Path, filler: Path | None = None) -> Path:
    """Record a trip about as fast as a drive, on a disk that a file fills; the session."""
    hub, published = Hub(), 0
    told, heard = hub.subscribe(Event, size=100), list[str]()
    log = sessions.with_name("motor.log")
    clock = lambda: (time.monotonic(), time.time())  # noqa: E731
    pace = Pace(flush_s=0.05, close_s=PATIENCE_S, trip_s=0.5)
    recorder = Recorder(log, sessions, Header(INFO, ""), hub, clock, pace)
    running = asyncio.create_task(recorder.run())
    async with asyncio.timeout(PATIENCE_S):
        while "the record of the trip is in" not in "".join(heard):
            hub.publish(replace(make_tick(published), time_s=time.monotonic()))
            published += 1
            if published == 300:
                if filler is not None:
                    fill(filler)
                hub.publish(Event("trip", Severity.ALARM, "over-voltage: 431 V", published))
            heard += [one.detail for one in told.drain() if isinstance(one, Event)]
            await asyncio.sleep(0.005)
    if filler is not None:
        filler.unlink()  # noqa: ASYNC240
    running.cancel()
    await asyncio.wait([running])
    return next(session_directories(sessions))


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 6 MB, where one may be mounted."""
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", str(disk)]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        pytest.skip("no disk can be mounted here")
    yield disk
    subprocess.run(["umount", "--lazy", str(disk)], check=True)


@pytest.mark.proof
async def test_a_trip_fits_on_a_full_disk(small_disk: Path) -> None:
    directory = await record_trip(small_disk / "sessions", small_disk / "fill")
    (trip,) = directory.glob("trip-*")
    assert len(sequences(read_session(trip))) > 100


@pytest.mark.proof
async def test_files_named_like_modules_in_the_working_folder_keep_nothing_from_being_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started_ = tmp_path / "started"
    code = f"open({str(started_)!r}, 'a').write('x')\nraise OSError"
    for name in ("inspect", "queue", "random", "select", "statistics", "struct", "matplotlib"):
        (tmp_path / f"{name}.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    directory = await record_trip(tmp_path / "sessions")
    assert not started_.exists()
    (trip,) = directory.glob("trip-*")
    assert (trip / "trip.txt").read_text().startswith("over-voltage: 431 V")
