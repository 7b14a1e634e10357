"""Status frame in to command frame out, against bare echoes on the same bus."""

from __future__ import annotations

import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.benchmarks.prober import SETTLE_S
from tools.benchmarks.rows import Extent, Row, quantile
from tools.benchmarks.site import Running, enable, runs, site
from tools.benchmarks.tools import PRIORITY, bus_ports, process, run_json

_WAYS: dict[str, dict[str, str]] = {
    "": {},
    ", cpu_latency_us = 0": {"realtime.cpu_latency_us": "0"},
}


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    ways = list(_WAYS.items())
    for how, changes in extent.pick(ways, ways, ways[:1]):
        yield from _against_echoes(extent.pick(25, 10, 2), changes, how)


def _against_echoes(seconds: int, changes: dict[str, str], how: str) -> Iterator[Row]:
    with TemporaryDirectory() as name, ExitStack() as stack:
        running, _ = stack.enter_context(site(changes))
        ports = [running.bus_port, *bus_ports(2)]
        stack.enter_context(process([sys.executable, "-m", "tools.benchmarks.echo", str(ports[1])]))
        stack.enter_context(process([*_fifo(), compile_echo(Path(name)), str(ports[2])]))
        time.sleep(3.0)
        times = probe(running, seconds, ports)
    ours, python, c = ([one for one in times[str(port)] if one >= 0.0] for port in ports)
    if not (ours and python and c):
        raise RuntimeError("no answers on the bus")
    missing = sum(one < 0.0 for one in times[str(ports[0])])
    note = f"{len(ours)} half cycles, {missing} without an answer in 6 ms"
    for share, name_of in ((0.50, "p50"), (0.99, "p99"), (0.999, "p99.9")):
        found, held = quantile(ours, share), quantile(python, share)
        most = 2.0 if not changes else 1.5
        target = f"at most {most:g} times" if name_of == "p50" else ""
        met = found <= most * held if name_of == "p50" else None
        label = f"turn-around {name_of}{how}"
        yield Row(label, found, "us", held, "bare-socket echo in Python", target, met, note)
        yield Row(label, found, "us", quantile(c, share), "bare-socket echo in C")


def probe(running: Running, seconds: float, ports: list[int]) -> dict[str, list[float]]:
    """Replay frames for so long, with the drive running."""
    operator = threading.Thread(target=enable, args=(running,))
    operator.start()
    words = ",".join(map(str, ports))
    times = run_json("tools.benchmarks.prober", seconds + SETTLE_S, words)
    operator.join()
    if not runs(running):
        log = running.log.read_text(encoding="utf-8")
        raise RuntimeError(f"the drive did not run: {log}")
    return times


def compile_echo(folder: Path) -> Path:
    """The echo in C."""
    if shutil.which("cc") is None:
        raise RuntimeError("no C compiler")
    program = folder / "echo"
    source = Path(__file__).with_name("echo.c")
    subprocess.run(["cc", "-O2", "-Wall", "-o", program, source], check=True)
    return program


def _fifo() -> list[str]:
    probe = subprocess.run(["chrt", "-f", str(PRIORITY), "true"], check=False, capture_output=True)
    return ["chrt", "-f", str(PRIORITY)] if probe.returncode == 0 else []
