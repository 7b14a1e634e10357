"""One daemon as a process, with a broker, set up in real time as far as it is granted."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support import MosquittoLauncher, Process, free_port, stop_process
from tests.system.daemon.site import Site, motor_configuration
from tools.benchmarks.prober import SETTLE_S
from tools.benchmarks.tools import BUSY, PRIORITY, bus_ports, process, run_json

REALTIME = {
    "realtime.priority": str(PRIORITY),
    "interlocks.stale_s": "0.2",
}


@dataclass
class Running:
    """A running daemon."""

    daemon: subprocess.Popen[bytes]
    bus_port: int
    broker_port: int
    log: Path

    def ask(self, verb: str, value: object = None, drive: str = "motor") -> None:
        """Send a command."""
        payload = json.dumps({"id": f"{verb}-{time.monotonic_ns()}", "value": value})
        topic = f"adaptdrive/{drive}/command/{verb}"
        command = ["mosquitto_pub", "-p", str(self.broker_port), "-t", topic, "-q", "1"]
        subprocess.run([*command, "-m", payload], check=True, timeout=20.0)


def start_daemon(  # noqa: PLR0917
    stack: ExitStack,
    folder: Path,
    bus_port: int,
    broker_port: int,
    changes: dict[str, str],
    environment: dict[str, str] = BUSY,
) -> Running:
    """Start a daemon."""
    folder.mkdir(parents=True, exist_ok=True)
    config = folder / "motor.toml"
    config.write_text(motor_configuration(broker_port, bus_port, REALTIME | changes))
    log = folder / "daemon.log"
    output = stack.enter_context(log.open("ab"))
    command = [sys.executable, "-m", "adaptdrive.cli", "run", str(config)]
    streams = {"stdout": output, "stderr": output}
    daemon = stack.enter_context(process(command, cwd=folder, env=environment, **streams))
    return Running(daemon, bus_port, broker_port, log)


@contextmanager
def broker(folder: Path) -> Iterator[tuple[Process, int]]:
    """A mosquitto, and its port."""
    port = free_port(socket.SOCK_STREAM)
    started = MosquittoLauncher("/usr/sbin/mosquitto", folder).start(port)
    try:
        yield started, port
    finally:
        stop_process(started)


@contextmanager
def site(
    changes: dict[str, str], environment: dict[str, str] = BUSY
) -> Iterator[tuple[Running, Process]]:
    """A daemon and its broker, in a folder that is removed."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        mosquitto, port = stack.enter_context(broker(folder))
        (bus_port,) = bus_ports(1)
        yield start_daemon(stack, folder, bus_port, port, changes, environment), mosquitto


@contextmanager
def prompt_site(folder: Path, environment: dict[str, str] | None = None) -> Iterator[Site]:
    """A broker and a simulated drive with real-time priority, for a daemon that has it, too."""
    launcher = MosquittoLauncher("/usr/sbin/mosquitto", folder)
    ports = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
    with closing(Site(folder, launcher, *ports, REALTIME, environment=environment or {})) as site:
        site.start_broker()
        site.start_device("--initial-voltage", "280")
        for one in (site.broker, site.device):
            if one is not None:
                os.sched_setscheduler(one.pid, os.SCHED_FIFO, os.sched_param(PRIORITY))
        yield site


def await_broker(running: Running, patience_s: float = 120.0) -> None:
    """Wait until a daemon takes commands."""
    deadline_s = time.monotonic() + patience_s
    while "broker connected" not in running.log.read_text(encoding="utf-8"):
        if time.monotonic() > deadline_s:
            raise RuntimeError(f"a daemon does not start: {running.log.read_text('utf-8')}")
        time.sleep(0.1)


def enable(running: Running, drive: str = "motor", patience_s: float = 120.0) -> None:
    """Ask until the drive runs or patience ends: its first frames may be still to come."""
    deadline_s = time.monotonic() + patience_s
    while not runs(running) and time.monotonic() < deadline_s:
        running.ask("enable", drive=drive)
        time.sleep(0.4)


def runs(running: Running) -> bool:
    """Whether the drive has been running."""
    return "starting to running" in running.log.read_text(encoding="utf-8")


def probe(running: Running, seconds: float, ports: list[int]) -> dict[str, list[float]]:
    """Replay frames for so long, with the drive running; return the times to the answers."""
    operator = threading.Thread(target=enable, args=(running,))
    operator.start()
    words = ",".join(map(str, ports))
    times = run_json("tools.benchmarks.prober", seconds + SETTLE_S, words)
    operator.join()
    if not runs(running):
        log = running.log.read_text(encoding="utf-8")
        raise RuntimeError(f"the drive did not run: {log}")
    return times
