"""Fixtures for every test: leaked tasks, free ports, real processes, a real broker."""

from __future__ import annotations

import asyncio
import fcntl
import math
import os
import shutil
import socket
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from adaptdrive.app.lock import NAMESPACE
from tests.support import (
    Broker,
    MosquittoLauncher,
    Process,
    Spawn,
    free_port,
    start_process,
    stop_process,
)

# A busy machine is no failure, and the change gate is the same twice.
settings.register_profile(
    "adaptdrive",
    deadline=None,
    derandomize="CI" in os.environ,
    max_examples=int(os.environ.get("EXAMPLES", "25")),
)
settings.load_profile("adaptdrive")


# Drives of the same name on several workers, or beside the suite, are not the same drive.
os.environ[NAMESPACE] = f"tests-{os.getpid()}"

CALCULATING = {
    "campaign",
    "closed_loop",
    "compiled",
    "config",
    "control",
    "experiments",
    "faults",
    "soak",
}
"""Folders whose tests need nothing but a processor, however busy."""

LONG = "system"
"""Folder of long tests.

They, slow ones, and before all those with a time limit of their own start first: none runs on when
all others have ended.
"""

COMPILING = {"campaign", "compiled"}
"""Folders whose tests compile the simulators.

Their tests come before all others, one worker compiles, and the others find the code on disk. They
count as slow: `make quick` compiles nothing.
"""

COMPILATION_S = 3600.0
"""Time limit of such a test: it compiles for minutes, and on a busy machine for half an hour."""

KINDS = {"calculating", "waiting", "alone", "proof"}


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files without a test of the kind that was asked for: reading all takes time."""
    kind, _, _ = config.getoption("markexpr").partition(" ")
    if kind not in ("calculating", "waiting", "alone") or collection_path.suffix != ".py":
        return None
    of_folder = "calculating" if _folder(collection_path) in CALCULATING else "waiting"
    if kind == of_folder or f"mark.{kind}" in collection_path.read_text(encoding="utf-8"):
        return None
    return True


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give every test one of four marks, so that each kind can run beside its like."""
    for item in items:
        if not any(item.get_closest_marker(kind) for kind in KINDS):
            calculating = _folder(item.path) in CALCULATING
            item.add_marker(pytest.mark.calculating if calculating else pytest.mark.waiting)
        if _folder(item.path) in COMPILING:
            item.add_marker(pytest.mark.timeout(COMPILATION_S))
            item.add_marker(pytest.mark.slow)
    items.sort(key=_turn)


def _turn(item: pytest.Item) -> tuple[bool, bool, bool, bool]:
    """Return when a test has its turn: the smallest first."""
    folder = _folder(item.path)
    longest = item.get_closest_marker("timeout") is not None
    slow = item.get_closest_marker("slow") is not None
    return folder not in COMPILING, not slow, not longest, folder != LONG


def _folder(path: Path) -> str:
    here = Path(__file__).parent
    return path.relative_to(here).parts[0] if path.is_relative_to(here) else ""


@pytest.fixture(autouse=True)
def _compiled_by_one_process(request: pytest.FixtureRequest) -> None:
    slow = request.node.get_closest_marker("slow") is not None
    if slow and _folder(request.path) in {*COMPILING, "experiments"}:
        request.getfixturevalue("compiled_simulators")


@pytest.fixture(scope="session")
def compiled_simulators() -> None:
    """Compile the simulators, or wait until another worker has, which takes two minutes."""
    from adaptdrive_sim.campaign.main import read_any_campaign, run_seed  # noqa: PLC0415
    from adaptdrive_sim.compiled.translate import cache_folder  # noqa: PLC0415

    campaign = read_any_campaign(Path("standard.toml"))
    cache_folder().mkdir(parents=True, exist_ok=True)
    with (cache_folder() / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        run_seed(campaign.model_copy(update={"duration_s": 180.0}), 1)


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
def free_udp_port() -> int:
    """A UDP port that nobody held a moment ago."""
    return free_port(socket.SOCK_DGRAM)


@pytest.fixture
def free_tcp_port() -> int:
    """A TCP port that nobody held a moment ago."""
    return free_port(socket.SOCK_STREAM)


@pytest.fixture
def spawn(tmp_path: Path) -> Iterator[Spawn]:
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
def mosquitto_launcher(tmp_path_factory: pytest.TempPathFactory) -> MosquittoLauncher:
    """For tests that stop and restart a broker of their own; they end what they start."""
    program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
    if program is None:
        pytest.skip("mosquitto is not installed")
    return MosquittoLauncher(program, tmp_path_factory.mktemp("mosquitto"))


@pytest.fixture(scope="session")
def mosquitto(mosquitto_launcher: MosquittoLauncher) -> Iterator[Broker]:
    """One real broker for all tests: use topics of your own."""
    port = free_port(socket.SOCK_STREAM)
    process = mosquitto_launcher.start(port)
    yield Broker("127.0.0.1", port)
    stop_process(process)
