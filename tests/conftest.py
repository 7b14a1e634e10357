"""Marks by nature, the guard of unit tests, virtual time, and the fixtures that reach outside.

A test is `integration` when a fixture that it asks for reaches outside this process, else `unit`: a
unit test that opens a socket, starts a process or sleeps fails. Time is virtual in all tests but
those in `tests/system`, where processes, brokers and drives run in real time.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import shutil
import socket
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from adaptdrive.app.process import NAMESPACE
from tests.support import (
    Broker,
    MosquittoLauncher,
    Process,
    Spawn,
    free_port,
    start_process,
    stop_process,
)
from tests.unit.devices.memory import in_memory
from tests.virtual_time import VirtualLoop, links_held

# A busy machine is no failure. Each run draws the same examples; the proof, which asks for a number
# of them, draws new ones.
settings.register_profile(
    "adaptdrive",
    deadline=None,
    derandomize="EXAMPLES" not in os.environ,
    max_examples=int(os.environ.get("EXAMPLES", "25")),
)
settings.load_profile("adaptdrive")


# Drives of the same name on several workers, or beside the suite, are not the same drive.
os.environ[NAMESPACE] = f"tests-{os.getpid()}"

REAL_TIME = tuple(Path(__file__).parent / name for name in ("system", "peers"))
"""Folder of the tests that run in real time."""

OUTSIDE = "outside"
"""Fixture of the tests that leave this process: every fixture that does so asks for it."""

FORBIDDEN = {
    "os.exec": "starts a process",
    "os.fork": "starts a process",
    "os.posix_spawn": "starts a process",
    "subprocess.Popen": "starts a process",
    "socket.bind": "opens a socket",
    "socket.connect": "opens a socket",
}
"""Events of the interpreter that fail a unit test, and what such a test does."""


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test by what its fixtures do, and begin with those of the system.

    Scenes wait while they run. One worker runs them all, one after the other, and the other worker
    calculates meanwhile.
    """
    for item in items:
        item.add_marker(pytest.mark.integration if _is_outside(item) else pytest.mark.unit)
    items.sort(key=lambda item: not in_real_time(item.path))


def in_real_time(path: Path) -> bool:
    """Return whether a test runs in real time, with processes."""
    return any(path.is_relative_to(folder) for folder in REAL_TIME)


def _is_outside(item: pytest.Item) -> bool:
    return in_real_time(item.path) or OUTSIDE in getattr(item, "fixturenames", ())


def pytest_asyncio_loop_factories(
    item: pytest.Item,
) -> Mapping[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Run system tests in real time, every other test in virtual time."""
    if in_real_time(item.path):
        return {"real": asyncio.SelectorEventLoop}
    return {"virtual": VirtualLoop}


class _Guard:
    """Fails the unit test that runs when it reaches outside this process."""

    def __init__(self) -> None:
        self.is_armed = False
        self.found = ""

    def see(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Take an event of the interpreter."""
        if self.is_armed and event in FORBIDDEN and not _is_local(event, arguments):
            self.refuse(f"a unit test {FORBIDDEN[event]}: {event}{arguments!r:.200}")

    def refuse(self, reason: str) -> None:
        """End the test; the reason is kept where the code under test swallows the failure."""
        self.found = self.found or reason
        pytest.fail(reason)


def _is_local(event: str, arguments: tuple[Any, ...]) -> bool:
    """Return whether a socket joins two ends of this process, as the pair of an event loop."""
    return event.startswith("socket.") and arguments[0].family == socket.AF_UNIX


_guard = _Guard()
sys.addaudithook(_guard.see)


@pytest.fixture(autouse=True)
def _guarded(request: pytest.FixtureRequest) -> Iterator[None]:
    """Let no unit test open a socket, start a process or sleep, and none but system tests sleep."""
    with contextlib.nullcontext() if in_real_time(request.path) else _in_virtual_time():
        _guard.found, _guard.is_armed = "", not _is_outside(request.node)
        yield
        _guard.is_armed = False
    if _guard.found:
        pytest.fail(_guard.found)


@contextlib.contextmanager
def _in_virtual_time() -> Iterator[None]:
    """Hold links and forbid sleeps.

    The patches are not those of the fixture `monkeypatch`: a test would then undo its own ones
    after those of `memory`, and leave the links of the next tests in memory.
    """
    with links_held(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "sleep", lambda _: _guard.refuse("a test outside tests/system sleeps"))
        yield


@pytest.fixture
def memory() -> Iterator[None]:
    """Let polled links end in memory, where exact times are kept, and not in the kernel."""
    with in_memory():
        yield


@pytest.fixture
def outside() -> None:
    """Let a test open sockets and start processes; makes it an integration test."""


@pytest.fixture(autouse=True)
def _no_leaked_task(request: pytest.FixtureRequest) -> None:
    if request.node.get_closest_marker("asyncio"):
        request.getfixturevalue("_tasks_of_test")


@pytest.fixture
async def _tasks_of_test(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[None]:
    """Fail the test when a task outlives it and the fixtures that it asked for."""
    loop = asyncio.get_running_loop()
    loop.set_debug(True)
    # its checks, but not the stack of each future, which is a third of the processor time
    monkeypatch.setattr(loop, "get_debug", lambda: False)
    loop.slow_callback_duration = math.inf  # a busy machine is no failure
    before = asyncio.all_tasks()
    yield
    left = [task for task in asyncio.all_tasks() - before if task is not asyncio.current_task()]
    cancelled = [task for task in left if task.cancelling()]
    if cancelled:
        await asyncio.wait(cancelled, timeout=1.0)
    pending = [task for task in left if not task.done()]
    if pending:
        pytest.fail("the test left tasks pending:\n" + "\n".join(map(repr, pending)))


@pytest.fixture
def free_udp_port(outside: None) -> int:
    """A UDP port that nobody held a moment ago."""
    return free_port(socket.SOCK_DGRAM)


@pytest.fixture
def free_tcp_port(outside: None) -> int:
    """A TCP port that nobody held a moment ago."""
    return free_port(socket.SOCK_STREAM)


@pytest.fixture
def spawn(outside: None, tmp_path: Path) -> Iterator[Spawn]:
    """Start processes that end with the test; their output goes to `tmp_path/process-N.log`."""
    running: list[Process] = []

    def start(*command: str | Path) -> Process:
        process = start_process(command, tmp_path / f"process-{len(running)}.log")
        running.append(process)
        return process

    yield start
    for process in reversed(running):
        stop_process(process)


@pytest.fixture(scope="session")
def _mosquitto_program(tmp_path_factory: pytest.TempPathFactory) -> MosquittoLauncher:
    program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
    if program is None:
        pytest.skip("mosquitto is not installed")
    return MosquittoLauncher(program, tmp_path_factory.mktemp("mosquitto"))


@pytest.fixture
def mosquitto_launcher(outside: None, _mosquitto_program: MosquittoLauncher) -> MosquittoLauncher:
    """For tests that stop and restart a broker of their own; they end what they start."""
    return _mosquitto_program


@pytest.fixture(scope="session")
def _running_mosquitto(_mosquitto_program: MosquittoLauncher) -> Iterator[Broker]:
    port = free_port(socket.SOCK_STREAM)
    process = _mosquitto_program.start(port)
    yield Broker("127.0.0.1", port)
    stop_process(process)


@pytest.fixture
def mosquitto(outside: None, _running_mosquitto: Broker) -> Broker:
    """One real broker for all tests: use topics of your own."""
    return _running_mosquitto
