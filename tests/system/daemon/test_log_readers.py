"""A log that nobody reads, or that was closed, and the drive of the daemon that writes it."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest

from tests.support import stop_process
from tests.system.conftest import MakeSite
from tests.system.daemon.site import PATIENCE_S, BusEar, Site, until

pytestmark = pytest.mark.proof

_PIPE_BYTES = 4096
_LINE_BYTES = 300


@dataclass
class Piped:
    """A site whose daemon writes its log into a pipe that this test reads or does not."""

    site: Site
    reader: int
    heard: list[str] = field(default_factory=list)

    def fill(self) -> None:
        """Have the daemon write lines until no further one fits into the pipe."""

        def full() -> bool:
            self.site.ask("enable")
            self.site.ask("disable")
            return self.waiting() > _PIPE_BYTES - _LINE_BYTES

        until(full, "a full pipe")

    def waiting(self) -> int:
        """Bytes in the pipe."""
        return int.from_bytes(fcntl.ioctl(self.reader, termios.FIONREAD, bytes(4)), sys.byteorder)

    def read(self) -> threading.Thread:
        """Read from now on, until the daemon ends."""

        def work() -> None:
            with os.fdopen(self.reader, encoding="utf-8") as lines:
                self.heard.extend(lines)

        thread = threading.Thread(target=work)
        thread.start()
        return thread


@pytest.fixture
def piped(make_site: MakeSite) -> Iterator[Piped]:
    site = make_site()
    site.start_broker()
    site.start_device("--initial-voltage", "280")
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    site.daemon = subprocess.Popen(
        [sys.executable, "-m", "adaptdrive.cli", "run", site.config],
        stdin=subprocess.DEVNULL,
        stdout=writer,
        stderr=writer,
        cwd=site.folder,
        env=os.environ | {"STATE_DIRECTORY": str(site.folder)},
    )
    os.close(writer)
    try:
        site.await_availability("online")
        site.await_measurement()
        yield Piped(site, reader)
    finally:
        stop_process(site.daemon)


def commands_go_on(site: Site) -> None:
    """Ticks still have their commands; a busy machine may trip the drive, which has them too."""
    with BusEar(site.config) as bus:
        until(lambda: len(bus.commands()) > 120, "the commands of a second")


def test_a_log_that_nobody_reads_stops_no_command(piped: Piped) -> None:
    piped.fill()
    for _ in range(3):
        piped.site.ask("enable")
        piped.site.demand("disable")
    commands_go_on(piped.site)
    reading = piped.read()
    assert piped.site.stop_daemon() == 0
    reading.join(PATIENCE_S)
    entries = [json.loads(line) for line in piped.heard]
    assert sum(entry["event"] == "standby to starting" for entry in entries) >= 3
    assert entries[-1]["event"] == "stopped"


def test_a_log_that_was_closed_leaves_the_drive_controlled(piped: Piped) -> None:
    os.close(piped.reader)
    for _ in range(3):
        piped.site.ask("enable")
        piped.site.demand("disable")
    commands_go_on(piped.site)
    assert piped.site.stop_daemon() == 0
