"""A disk that is full, read-only or stalled: the drive runs on, and recording resumes by itself."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from adaptdrive.recording.reader import read_session
from adaptdrive.recording.session import Dropped, Ending, session_directories
from tests.support import slow_disk
from tests.system.conftest import MakeSite
from tests.system.daemon.own_disk import mounted, run_privileged, stalled
from tests.system.daemon.site import BusEar, Site, until
from tests.unit.cli.here import run_here

pytestmark = pytest.mark.proof

FAULT_S = 3.0
SLOW_FSYNC_S = 5.0
RESUMED_S = 60.0

Fault = Callable[[Path], contextlib.AbstractContextManager[None]]


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own, where one may be mounted."""
    with mounted(tmp_path) as folder:
        if folder is None:
            pytest.skip("no disk can be mounted here, or e2fsprogs or util-linux is not installed")
        yield folder


@contextlib.contextmanager
def full(disk: Path) -> Iterator[None]:
    filling = disk / "filling"
    with contextlib.suppress(OSError), filling.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))
    try:
        yield
    finally:
        filling.unlink()


@contextlib.contextmanager
def read_only(disk: Path) -> Iterator[None]:
    """No file can be changed or made, those that are open included."""
    assert run_privileged("chattr", "-R", "+i", disk)
    try:
        yield
    finally:
        assert run_privileged("chattr", "-R", "-i", disk)


def _reported(site: Site, text: str) -> bool:
    return any(text in heard.content["detail"] for heard in site.ear.on("event"))


@pytest.mark.parametrize("fault", [full, read_only, stalled])
def test_the_drive_runs_on_and_recording_resumes(
    make_site: MakeSite, disk: Path, fault: Fault
) -> None:
    site = make_site()
    site.environment["STATE_DIRECTORY"] = str(disk)
    site.start("--initial-voltage", "280")
    site.run_drive()
    folder = newest(disk / "sessions")
    until(lambda: read_session(folder).ticks.num_rows > 120, "ticks are recorded")
    with BusEar(site.config) as bus, fault(disk):
        time.sleep(FAULT_S)
        if fault is not stalled:
            until(lambda: _reported(site, "recording has stopped"), "the report of the fault")
        commands = bus.commands()
    assert len(commands) > 60
    assert all(command.bridge for command in commands)
    ticks = site.ear.on("telemetry/drive")[-1].content["ticks"]
    until(lambda: read_session(folder).ticks.num_rows > ticks, "recording resumes", RESUMED_S)
    assert site.state["state"] == "running"
    assert site.stop_daemon() == 0
    session = read_session(folder)
    assert session.ticks["sequence"].to_pylist() == list(range(session.ticks.num_rows))
    assert session.info.ended is Ending.ORDERLY
    assert session.info.dropped == Dropped()
    said = [event.detail for event in session.events if event.kind == "recording"]
    if fault is not stalled:
        assert any("recording has stopped" in detail for detail in said)
        assert any("recording continues" in detail for detail in said), said


def test_a_stop_on_a_full_disk_leaves_a_whole_session(make_site: MakeSite, disk: Path) -> None:
    """All of it is in its files, and stays there once the disk is free again."""
    site = make_site()
    site.environment["STATE_DIRECTORY"] = str(disk)
    site.start("--initial-voltage", "280")
    site.run_drive()
    folder = newest(disk / "sessions")
    until(lambda: read_session(folder).ticks.num_rows > 120, "ticks are recorded")
    with full(disk):
        until(lambda: _reported(site, "recording has stopped"), "the report of the fault")
        assert site.stop_daemon() == 0
    answer = run_here("sessions", "verify", STATE_DIRECTORY=str(disk))
    assert (answer.returncode, answer.stderr) == (0, "")
    session = read_session(folder)
    assert session.info.ended is Ending.ORDERLY
    assert session.info.dropped == Dropped()
    assert (folder / "ticks-0001.parquet").exists()
    ticks = site.ear.on("telemetry/drive")[-1].content["ticks"]
    assert session.ticks["sequence"].to_pylist() == list(range(session.ticks.num_rows))
    assert session.ticks.num_rows > ticks


def test_a_slow_disk_holds_up_no_end_and_loses_no_event(make_site: MakeSite) -> None:
    site = make_site()
    site.start_broker()
    site.start_device("--initial-voltage", "280")
    environment = slow_disk(site.folder, SLOW_FSYNC_S)
    if environment is None:
        pytest.skip("no C compiler")
    site.environment.update(environment)
    site.start_daemon()
    for mode in ("adaptive", "fixed", "adaptive", "fixed"):
        site.demand("mode", mode)
    assert site.stop_daemon() == 0  # within the patience of the site, four such writes
    events = [one.content for one in site.ear.on("event")]
    published = [one["detail"] for one in events if one["kind"] != "recording"]
    site.environment.clear()
    folder = newest(site.folder / "sessions")
    site.start_daemon()
    until(lambda: read_session(folder).info.ended is not Ending.OPEN, "the session is closed")
    recorded = [event.detail for event in read_session(folder).events]
    assert published.count("mode fixed to adaptive") == 2
    assert set(published) <= set(recorded)


def newest(sessions: Path) -> Path:
    return until(lambda: list(session_directories(sessions)), "a session begins", RESUMED_S)[-1]
