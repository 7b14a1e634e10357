"""Processes that are owned: started, watched, ended in order, and never left behind."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from pathlib import Path

import pytest

from adaptdrive.processes import TETHER, Ports, ProcessDiedError, ProcessGroup
from tests.support import Spawn, free_port

pytestmark = pytest.mark.usefixtures("outside")

PATIENCE_S = 120.0
SLEEPER = """
import pathlib, signal, sys, time
def end(*_):
    with open(sys.argv[1], "a") as log:
        log.write(sys.argv[2] + "\\n")
    sys.exit(0)
signal.signal(signal.SIGTERM, end)
pathlib.Path(sys.argv[2]).touch()
time.sleep(60)
"""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Makes `python -m sleeper` work."""
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    return {**os.environ, "PYTHONPATH": str(tmp_path)}


def wait_for(path: Path) -> str:
    deadline = time.monotonic() + PATIENCE_S
    while not path.exists() or not path.read_text().strip():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return path.read_text().strip()


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # A process that has ended but was not waited for is dead all the same.
    return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()


@asynccontextmanager
async def started(environment: dict[str, str]) -> AsyncIterator[ProcessGroup]:
    processes = ProcessGroup(environment)
    try:
        yield processes
    finally:
        await processes.stop()


async def test_the_last_one_started_ends_first(
    tmp_path: Path, environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    async with started(environment) as processes:
        for name in ("broker", "drive", "daemon"):
            await processes.start(name, "sleeper", ["ends", name], tmp_path / f"{name}.log")
            while not (tmp_path / name).exists():  # noqa: ASYNC110
                await asyncio.sleep(0.02)
    assert (tmp_path / "ends").read_text().split() == ["daemon", "drive", "broker"]


async def test_the_first_death_is_told_with_the_end_of_its_log(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    (tmp_path / "broken.py").write_text("raise SystemExit('the capacitor is missing')")
    log = tmp_path / "daemon.log"
    async with started(environment) as processes:
        await processes.start("daemon", "broken", [], log)
        with pytest.raises(ProcessDiedError) as died:
            await processes.watch()
    assert str(died.value) == f"the daemon ended with status 1; see {log}"
    assert died.value.tail == ["the capacitor is missing"]


def test_a_tied_process_dies_with_its_parent(tmp_path: Path, spawn: Spawn) -> None:
    child = "import os, time; print(os.getpid(), flush=True); time.sleep(60)"
    parent = (
        "import os, subprocess, sys\n"
        f"subprocess.Popen([sys.executable, '-c', {TETHER!r}, str(os.getpid()),"
        f" sys.executable, '-c', {child!r}], start_new_session=True).wait()"
    )
    process = spawn(sys.executable, "-c", parent)
    pid = int(wait_for(tmp_path / "process-0.log"))
    assert alive(pid)
    process.send_signal(signal.SIGKILL)
    process.wait()
    deadline = time.monotonic() + PATIENCE_S
    while alive(pid):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_process_whose_parent_is_gone_is_not_started(tmp_path: Path, spawn: Spawn) -> None:
    process = spawn(sys.executable, "-c", TETHER, "1", sys.executable, "-c", "print('started')")
    assert process.wait(timeout=PATIENCE_S) == 1
    assert "is gone" in (tmp_path / "process-0.log").read_text()


def test_of_two_programs_that_start_at_once_each_takes_a_port_of_its_own() -> None:
    usual = free_port(socket.SOCK_STREAM)
    first, second, third = Ports(), Ports(), Ports()
    assert first.take(usual=usual) == usual
    assert second.take(usual=usual) != usual
    first.close()
    assert third.take(usual=usual) == usual
    second.close()
    third.close()


async def test_a_port_that_is_held_can_be_listened_at_and_is_given_to_nobody_else() -> None:
    with closing(Ports()) as ports:
        taken = [ports.take() for _ in range(50)]
        assert len(set(taken)) == 50
        server = await asyncio.start_server(lambda _, __: None, "127.0.0.1", taken[0])
        server.close()
        await server.wait_closed()
