"""State that cannot be kept: the drive is controlled and stopped all the same."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from adaptdrive.recording.reader import read_session
from adaptdrive.recording.session import session_directories
from tests.system.conftest import MakeSite
from tests.system.daemon.site import Site, until

pytestmark = pytest.mark.proof


def events(site: Site, kind: str) -> list[str]:
    """Details of the events of a kind, once there is one."""
    found = until(
        lambda: [one for one in site.ear.on("event") if one.content["kind"] == kind], kind
    )
    return [one.content["detail"] for one in found]


def runs_and_stops(site: Site, status: int = 0) -> None:
    site.run_drive()
    site.demand("disable")
    assert site.stop_daemon() == status
    site.await_availability("offline")
    assert "Traceback" not in site.daemon_log


@pytest.mark.parametrize(
    "directory", ["/proc/no-sessions-here", "/dev/null/sessions"], ids=["read-only", "a device"]
)
def test_without_a_sessions_folder_it_drives_and_says_so(
    make_site: MakeSite, directory: str
) -> None:
    site = make_site({"recording.directory": f'"{directory}"'})
    site.start("--initial-voltage", "280")
    (said, *_) = events(site, "recording")
    assert said.startswith("nothing is recorded")
    assert directory in said
    runs_and_stops(site, status=4)
    assert "nothing is recorded" in site.daemon_log


DELETED = (
    "import os, sys;"
    "os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone');"
    "os.execv(sys.argv[1], sys.argv[1:])"
)


def test_in_a_folder_that_was_deleted_it_drives_and_says_so(make_site: MakeSite) -> None:
    site = make_site()
    site.environment["STATE_DIRECTORY"] = ""
    site.start_broker()
    site.start_device("--initial-voltage", "280")
    site.start_daemon(sys.executable, "-c", DELETED)
    site.await_measurement()
    (said, *_) = events(site, "recording")
    assert said.startswith("nothing is recorded")
    assert "state" in said
    runs_and_stops(site, status=4)


@pytest.mark.parametrize("make", [os.mkfifo, Path.touch], ids=["FIFO", "file"])
def test_what_is_no_folder_of_a_log_is_named_and_delays_nothing(
    make_site: MakeSite, make: Callable[[Path], None]
) -> None:
    site = make_site()
    make(site.folder / "motor.log")
    site.start("--initial-voltage", "280")
    assert "motor.log" in events(site, "recording")[0]
    runs_and_stops(site, status=4)


def test_a_state_folder_whose_name_is_no_utf_8_is_named_in_events(make_site: MakeSite) -> None:
    site = make_site({"recording.directory": '"sessions"'})
    state = site.folder / os.fsdecode(b"st\xff")
    state.mkdir()
    (state / "motor.log").mkdir()
    left = state / "motor.log" / "00000001-20260101T000000000000Z-0001.log"
    left.write_bytes(b"damaged" * 1000)
    site.environment["STATE_DIRECTORY"] = str(state)
    site.start("--initial-voltage", "280")
    assert r"st\udcff/motor.log" in events(site, "recording")[0]
    runs_and_stops(site)
    session = read_session(next(session_directories(site.folder / "sessions")))
    assert any(r"st\udcff/motor.log" in event.detail for event in session.events)
