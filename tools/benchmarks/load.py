"""What recorder, broker, operators and other processes can do to the fast loop: nearly nothing.

The measure is taken on the bus: from the drive's frame to the command that answers it. Telemetry
runs at its highest rate and the recorder records throughout.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager

from tests.support import Process, children
from tools.benchmarks.lateness import cyclictest
from tools.benchmarks.rows import Extent, Row, quantile
from tools.benchmarks.site import Running, probe, runs, site
from tools.benchmarks.tools import PRIORITY, process

HOG = "while True: pass"
COMMANDS_PER_S = 1000
LIMIT_US = 1000.0
TELEMETRY = {"mqtt.telemetry_Hz": "10.0"}


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file: each load against a quiet daemon, in turn."""
    seconds = extent.pick(24, 6, 1)
    quiet: list[float] = []
    names = tuple(_NAMES)
    for name in extent.pick(names, names, names[:2]):
        times, peer = _under(name, seconds)
        answered = [one for one in times if one >= 0.0] or [float("nan")]
        missing = len(times) - len(answered)
        late = [one if one >= 0.0 else math.inf for one in times]
        quiet = quiet or late
        found, held = quantile(late, 0.999), quantile(quiet, 0.999)
        note = f"{len(times)} half cycles, {missing} without an answer in 6 ms, "
        note += f"p50 {quantile(answered, 0.5):.0f}, max {max(answered):.0f} us; "
        note += f"cyclictest beside it p99.9 {quantile(peer, 0.999):.0f}, max {max(peer):.0f} us"
        limit = f"below {LIMIT_US:.0f} us, or cyclictest's"
        met = found < LIMIT_US or found <= quantile(peer, 0.999)
        label = f"turn-around p99.9 under load: {_NAMES[name]}"
        yield Row(label, found, "us", held, "the same without load", limit, met, note)


_NAMES = {
    "nothing else": "nothing else",
    "disk stalled": "disk stalled",
    "broker stalled": "broker stalled",
    "commands": f"{COMMANDS_PER_S} commands/s",
    "hog": "a CPU hog on each CPU",
    "all": "hogs, commands, disk stalled",
}


def _under(name: str, seconds: float) -> tuple[list[float], list[float]]:
    """Turn-around times, and what cyclictest suffers meanwhile at a higher priority."""
    with site(TELEMETRY) as (running, mosquitto), ThreadPoolExecutor(1) as beside:
        time.sleep(3.0)
        with _after_start(name, running, mosquitto):
            peer = beside.submit(cyclictest, seconds, PRIORITY + 20, tuning=False)
            times = probe(running, seconds, [running.bus_port])
    return times[str(running.bus_port)], peer.result()


@contextmanager
def _after_start(name: str, running: Running, mosquitto: Process) -> Iterator[None]:
    """Apply a load once the drive has been enabled, until the block ends."""
    ended = threading.Event()
    worker = threading.Thread(target=_load, args=(name, running, mosquitto, ended))
    worker.start()
    try:
        yield
    finally:
        ended.set()
        worker.join()


def _load(name: str, running: Running, mosquitto: Process, ended: threading.Event) -> None:
    while not runs(running):
        if ended.wait(0.05):
            return
    with ExitStack() as stack:
        if name in {"disk stalled", "all"}:
            for child in children(running.daemon.pid):
                stack.enter_context(_stopped(child))
        if name == "broker stalled":
            stack.enter_context(_stopped(mosquitto.pid))
        if name in {"commands", "all"}:
            words = [str(running.broker_port), str(COMMANDS_PER_S)]
            command = [sys.executable, "-m", "tools.benchmarks.flood", *words]
            stack.enter_context(process(command))
        if name in {"hog", "all"}:
            for _ in range(os.cpu_count() or 1):
                stack.enter_context(process([sys.executable, "-c", HOG]))
        ended.wait()


@contextmanager
def _stopped(pid: int) -> Iterator[None]:
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)
