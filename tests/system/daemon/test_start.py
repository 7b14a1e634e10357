"""`adaptdrive start`: one drive on a desk, in one terminal."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.pseudo_terminal import Screen
from tests.support import children, free_port
from tests.system.conftest import MakeSite
from tests.system.daemon.site import PATIENT, Site, motor_configuration, until


@contextmanager
def started(folder: Path, *options: str | Path) -> Iterator[tuple[subprocess.Popen[bytes], Screen]]:
    """Run the command in a terminal of its own."""
    screen = Screen()
    process = subprocess.Popen(
        [sys.executable, "-m", "adaptdrive.cli", "start", *options],
        cwd=folder,
        env=os.environ | {"TERM": "xterm", "LINES": "40", "COLUMNS": "120"},
        stdin=screen.inner,
        stdout=screen.inner,
        stderr=screen.inner,
    )
    try:
        yield process, screen
    finally:
        process.kill()
        process.wait()
        screen.close()


def family(process: subprocess.Popen[bytes]) -> list[int]:
    """All processes that it has started, and theirs."""
    found, unseen = [], [process.pid]
    while unseen:
        more = children(unseen.pop())
        found += more
        unseen += more
    return found


def none_left(pids: list[int]) -> bool:
    return not any(_runs(pid) for pid in pids)


def _runs(pid: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def status(process: subprocess.Popen[bytes], screen: Screen) -> int:
    """Read what it writes until it has ended; its exit status."""

    def ended() -> bool:
        screen.read()
        return process.poll() is not None

    try:
        until(ended, "it has ended")
    except AssertionError as late:
        raise AssertionError(f"{late}: {screen.read()[-2000:]}") from None
    return process.returncode


def enable(screen: Screen) -> None:
    until(lambda: " standby " in screen.read(), "the drive is heard")

    def runs() -> bool:
        screen.press("e")
        time.sleep(1.2)  # two presses at once confirm nothing
        return " running " in screen.read()

    until(runs, "the drive runs")


def test_one_terminal_runs_a_drive_and_ends_it_in_order(tmp_path: Path, free_tcp_port: int) -> None:
    """No broker answers: an embedded one is started; q ends panel, daemon, drive and broker."""
    text = motor_configuration(free_tcp_port, free_port(socket.SOCK_DGRAM), PATIENT)
    (tmp_path / "motor.toml").write_text(text)
    with started(tmp_path, "--simulate", "motor.toml") as (process, screen):
        until(lambda: "embedded one serves this machine only" in screen.read(), "the line")
        enable(screen)
        members = family(process)
        assert len(members) >= 4
        screen.press("q")
        assert status(process, screen) == 0
        said = screen.read()
    assert "ending: panel, daemon, simulated drive, broker" in said
    assert none_left(members)
    log = (tmp_path / "state" / "motor.daemon.out").read_text()
    assert "running to " in log
    assert log.splitlines()[-1].find("stopped") > 0


@pytest.fixture
def site(make_site: MakeSite) -> Site:
    site = make_site()
    site.start_broker()
    site.start_device()
    return site


@pytest.mark.proof
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_signal_to_the_starter_ends_all_with_the_drive_off(
    site: Site, number: signal.Signals
) -> None:
    with started(site.folder, site.config) as (process, screen):
        enable(screen)
        site.await_state(state="running")
        assert "embedded" not in screen.read()
        members = family(process)
        process.send_signal(number)
        assert status(process, screen) == (130 if number is signal.SIGINT else -number)
        until(lambda: none_left(members), "no process is left")
    assert site.state["state"] == "standby"
    assert site.ear.on("availability")[-1].payload == "offline"


@pytest.mark.proof
def test_a_daemon_that_dies_is_told_with_its_last_words(site: Site) -> None:
    """The drive is held by another daemon already; a remote broker is never replaced."""
    site.start_daemon()
    with started(site.folder, site.config) as (process, screen):
        assert status(process, screen) == 1
        said = " ".join(screen.read().split())
    assert "the daemon ended with status 1" in said
    assert "is controlled by process" in said
    assert site.daemon is not None
    assert site.daemon.poll() is None
    site.write({"mqtt.host": '"127.0.0.2"'})
    with started(site.folder, site.config) as (process, screen):
        assert status(process, screen) == 1
        assert f"no broker answers at 127.0.0.2:{site.broker_port}" in screen.read()
