"""What several tests need to talk to the world outside: ports, processes, a broker."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import random
import re
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import pytest

from adaptdrive.safety.trips import Trip, TripKind

Process = subprocess.Popen[bytes]


class Spawn(Protocol):
    """Starts a process that ends with the test."""

    def __call__(self, *command: str | Path) -> Process: ...


def sample(values: Sequence[Any], count: int) -> list[Any]:
    """Parameters of which `make test` runs the first ones, and `make proof` the others."""
    sets = [value if isinstance(value, tuple) else (value,) for value in values]
    others = [pytest.param(*one, marks=pytest.mark.proof) for one in sets[count:]]
    return [*values[:count], *others]


def _own_ports() -> Iterator[int]:
    """Ports of this test process alone, below those that the kernel gives to clients."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    first = int(os.environ.get("PORTS_FROM", "10000")) + 1_000 * (worker % 10)
    ports = list(range(first, first + 1_000))
    start = random.randrange(len(ports))
    return itertools.cycle(ports[start:] + ports[:start])


_PORTS = _own_ports()


def free_port(kind: socket.SocketKind) -> int:
    """A port of the loopback interface that nobody holds, and that no other test will get."""
    while True:
        port = next(_PORTS)
        with socket.socket(socket.AF_INET, kind) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


def has_can() -> bool:
    """Whether the kernel of this machine knows CAN."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def start_process(
    command: Sequence[str | Path], log: Path, environment: Mapping[str, str] | None = None
) -> Process:
    """Start a process without standard input; its output goes to `log`.

    Args:
        command: Program and words.
        log: Takes what it says.
        environment: What it finds in its environment beside this process's own.
    """
    with log.open("ab") as output:
        return subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=os.environ | dict(environment or {}),
        )


PREFERRED, SERVING = 10, 1
"""Real-time priorities: of drives and daemons, and of what serves them and delays none of them."""


def prefer(process: Process) -> None:
    """Schedule a started process before the other tests, where the machine grants it.

    A real drive shares no processor with anything, and a deployed daemon has real-time priority.
    Do so only once it runs: the imports of a starting process would delay the others.
    """
    _schedule(process.pid, os.SCHED_RR | os.SCHED_RESET_ON_FORK, PREFERRED)


def serve_promptly(pid: int) -> None:
    """Schedule a running process before everything but drives and daemons, where that is granted.

    Args:
        pid: The process: a broker, a recorder, or a part of a demonstration.
    """
    _schedule(pid, os.SCHED_RR | os.SCHED_RESET_ON_FORK, SERVING)


def _schedule(pid: int, policy: int, priority: int) -> None:
    with contextlib.suppress(FileNotFoundError, PermissionError, ProcessLookupError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            os.sched_setscheduler(int(task.name), policy, os.sched_param(priority))


def stop_process(process: Process) -> None:
    """End a process, by force when it does not end within ten seconds."""
    process.terminate()
    try:
        process.wait(timeout=10.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def complete_lines(log: Path) -> list[str]:
    """The lines of a file that another process writes, without one that is half written."""
    whole, _, _ = log.read_text(encoding="utf-8").rpartition("\n")
    return whole.splitlines()


def logged_events(log: Path, name: str) -> list[dict[str, Any]]:
    """The events of a name that a simulated drive wrote into its log."""
    entries = [json.loads(line) for line in complete_lines(log) if line.startswith("{")]
    return [entry for entry in entries if entry["event"] == name]


@contextlib.contextmanager
def captured_lines() -> Iterator[list[dict[str, Any]]]:
    """The log lines of this process while the block runs, as they are written."""
    lines: list[dict[str, Any]] = []

    class Lines(io.StringIO):
        def write(self, text: str) -> int:
            lines.append(json.loads(text))
            return len(text)

    with contextlib.redirect_stderr(Lines()):
        yield lines


def resident_MiB(pid: int) -> float:
    """Memory of a process that is resident."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def children(pid: int) -> list[int]:
    """Processes that a process has started; none of one that has ended."""
    try:
        text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return []
    return [int(one) for one in text.split()]


def suspended_machine(seconds: int) -> list[str]:
    """Return what starts a program on a machine that was suspended before, by a time namespace."""
    launcher = ["unshare", "--map-root-user", "--time", "--boottime", str(seconds)]
    if subprocess.run([*launcher, "true"], check=False, capture_output=True).returncode:
        pytest.skip("needs unshare, user namespaces and time namespaces")
    return launcher


def slow_disk(folder: Path, seconds: float) -> dict[str, str] | None:
    """Environment of a process whose every fsync takes so long, None without a C compiler.

    With `SLOW_WRITE_S` beside it each `write` to a file takes longer too.
    """
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    library = folder / "slow_disk.so"
    source = Path(__file__).with_name("slow_disk.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source], check=True)
    return {"LD_PRELOAD": str(library), "SLOW_DISK_S": str(seconds)}


@dataclass(frozen=True, slots=True)
class Broker:
    """Where a running broker is."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class MosquittoLauncher:
    """Starts mosquitto on a port, as often as a test wants.

    Attributes:
        program: mosquitto.
        folder: Takes its configuration and its log.
        more: Further listeners, in the words of its configuration.
    """

    program: str
    folder: Path
    more: str = ""

    def start(self, port: int) -> Process:
        """Start a broker on the loopback interface and wait until it listens on each port."""
        settings = self.folder / f"mosquitto-{port}.conf"
        own = f"listener {port} 127.0.0.1\nallow_anonymous true\n"
        settings.write_text(f"per_listener_settings true\n{own}{self.more}")
        log = settings.with_suffix(".log")
        process = start_process([self.program, "-c", settings], log)
        try:
            for one in (port, *re.findall(r"^listener (\d+) ", self.more, re.MULTILINE)):
                await_listener(process, int(one), log)
        except BaseException:
            stop_process(process)
            raise
        return process


def await_listener(process: Process, port: int, log: Path) -> None:
    """Wait until a broker listens on a port of the loopback interface."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline and process.poll() is None:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
        except OSError:
            time.sleep(0.02)
        else:
            return
    raise AssertionError(f"mosquitto does not listen on port {port}: {log.read_text()}")


@contextlib.contextmanager
def acting(number: signal.Signals) -> Iterator[None]:
    """Let programs that start here not inherit that a signal is ignored, as under `nohup`."""
    before = signal.signal(number, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(number, before)


def a_trip(text: str, kind: TripKind = TripKind.INTERNAL_ERROR) -> Trip:
    """Return a trip of which the text alone matters."""
    return Trip(kind, text)


def text_of(trip: Trip | None) -> str | None:
    """Return the text of a trip, None of none."""
    return None if trip is None else trip.text
