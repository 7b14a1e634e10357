"""A log that nobody reads, or that was closed, and the drive of the daemon that writes it."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest

from adaptdrive.app.output import LINES_HELD
from tests.support import stop_process
from tests.system.bus_ear import BusEar
from tests.system.conftest import MakeSite
from tests.system.site import PATIENCE_S, Site, until

_BATCH = 50
"""Commands at once: fewer than the daemon lets wait."""

_PIPE_BYTES = 4096
_ENOUGH_LINES = LINES_HELD + 2 * _PIPE_BYTES // 100


@dataclass
class Piped:
    """A site whose daemon writes its log into a pipe that this test reads or does not."""

    site: Site
    reader: int
    heard: list[str] = field(default_factory=list)

    def log_lines(self, count: int) -> None:
        """Have the daemon write lines: one for each command."""
        answered = 0
        while answered < count:
            wanted = len(self.site.ear.on("reply")) + _BATCH
            ids = range(answered, answered + _BATCH)
            commands = "".join(f'{{"id": "{n}-{count}", "value": "fixed"}}\n' for n in ids)
            topic = ("-t", "adaptdrive/motor/command/mode")
            subprocess.run(
                ["mosquitto_pub", "-p", str(self.site.broker_port), "-l", "-q", "1", *topic],
                input=commands.encode(),
                timeout=PATIENCE_S,
                check=True,
            )
            self.await_replies(wanted)
            answered += _BATCH

    def await_replies(self, wanted: int) -> None:
        until(lambda: len(self.site.ear.on("reply")) >= wanted, f"{wanted} replies")

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
        site.run_drive()
        yield Piped(site, reader)
    finally:
        stop_process(site.daemon)


def commands_go_on(site: Site) -> None:
    """Ticks still have their commands; a busy machine may trip the drive, which has them too."""
    with BusEar(site.config) as bus:
        until(lambda: len(bus.commands()) > 120, "the commands of a second")


def test_a_log_that_nobody_reads_costs_lines_alone(piped: Piped) -> None:
    piped.log_lines(_ENOUGH_LINES)
    commands_go_on(piped.site)
    reading = piped.read()
    piped.log_lines(_BATCH)
    assert piped.site.stop_daemon() == 0
    reading.join(PATIENCE_S)
    entries = [json.loads(line) for line in piped.heard]
    assert sum(entry.get("lost", 0) for entry in entries) > 0
    commands = [entry for entry in entries if entry["event"] == "command"]
    lost = sum(entry.get("lost", 0) for entry in entries)
    assert len(commands) + lost >= _ENOUGH_LINES
    assert entries[-1]["event"] == "stopped"


def test_a_log_that_was_closed_leaves_the_drive_controlled(piped: Piped) -> None:
    os.close(piped.reader)
    piped.log_lines(_BATCH)
    commands_go_on(piped.site)
    piped.site.demand("disable")
    assert piped.site.stop_daemon() == 0


def test_a_log_that_nobody_reads_delays_no_end(piped: Piped) -> None:
    piped.log_lines(2 * _BATCH)
    assert piped.site.stop_daemon() == 0
    piped.site.await_availability("offline")
    os.close(piped.reader)
