"""What one daemon costs: CPU, memory and its start."""

from __future__ import annotations

import select
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from adaptdrive import build_name
from tools.benchmarks.daemons import Census, measure
from tools.benchmarks.rows import Extent, Row
from tools.benchmarks.site import broker, start_daemon
from tools.benchmarks.tools import bus_ports, bus_socket, is_command

START_S = 0.6
SCRIPT = "script of an afternoon"
LARGEST_RATIO = 0.8 if build_name() == "compiled" else 1.0
"""Processor time of a daemon over that of the script of an afternoon."""


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    yield _start()
    seconds = extent.pick(30.0, 10.0, 2.0)
    yield from _asleep(seconds)
    changes = {"realtime.cpu_latency_us": "0"}
    yield from _shares(", cpu_latency_us = 0", measure(1, seconds, recording=True, changes=changes))


def _asleep(seconds: float) -> Iterator[Row]:
    census = measure(1, seconds, recording=True)
    resident = census.resident
    yield from _shares("", census)
    note = "memory locked as it is touched"
    met = resident <= 80.0
    held = census.script_resident
    yield Row("resident memory of a daemon", resident, "MiB", held, SCRIPT, "at most 80", met, note)


def _shares(how: str, census: Census) -> Iterator[Row]:
    name, own = f"CPU share of a daemon with its log{how}", census.cpu_share
    met = own <= LARGEST_RATIO * census.script_share
    target = f"at most {LARGEST_RATIO:g} times"
    yield Row(name, own, "%", census.script_share, SCRIPT, target, met)
    yield Row(f"{name}, echo", own, "%", census.echo_share, "bare-socket echo in Python")


def _start() -> Row:
    """From the start of the process to its first command on the bus."""
    times = []
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        _, port = stack.enter_context(broker(folder))
        for number in range(3):
            with ExitStack() as one:
                began_s = time.monotonic()
                (bus_port,) = bus_ports(1)
                running = start_daemon(one, folder / str(number), bus_port, port, {})
                bus = one.enter_context(bus_socket(running.bus_port))
                _await_command(bus.fileno(), began_s + 30.0)
                while not is_command(bus.recv(512)):
                    pass
                times.append(time.monotonic() - began_s)
    median = sorted(times)[1]
    name = "start of the process to first command on the bus"
    return Row(name, median, "s", target=f"at most {START_S:g} s", met=median <= START_S)


def _await_command(fileno: int, deadline_s: float) -> None:
    if not select.select([fileno], [], [], deadline_s - time.monotonic())[0]:
        raise RuntimeError("no command on the bus")
