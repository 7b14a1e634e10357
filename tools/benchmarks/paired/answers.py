"""Status frame in to command frame out, in turn with bare echoes on the same bus."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from statistics import median

from tools.benchmarks.paired.pairs import Effort, Row, Turn
from tools.benchmarks.paired.shares import ECHO
from tools.benchmarks.site import probe, site
from tools.benchmarks.tools import bus_ports, process

WAYS: dict[str, tuple[dict[str, str], float]] = {
    "turn-around": ({}, 2.0),
    "the same, `cpu_latency_us = 0`": ({"realtime.cpu_latency_us": "0"}, 1.5),
}
"""Settings of the daemon, and the largest ratio that is wanted."""


def rows(environments: dict[str, dict[str, str]], effort: Effort) -> Iterator[Row]:
    """Rows of all builds."""
    for name, (changes, most) in WAYS.items():
        for build, environment in environments.items():
            turns = _turns(changes, environment, effort)
            yield Row(name, build, "us", ECHO, turns, most_ratio=most)


def _turns(changes: dict[str, str], environment: dict[str, str], effort: Effort) -> list[Turn]:
    with ExitStack() as stack:
        running, _ = stack.enter_context(site(changes, environment))
        ports = [running.bus_port, *bus_ports(2)]
        for port in ports[1:]:
            words = [sys.executable, "-m", "tools.benchmarks.echo", str(port)]
            stack.enter_context(process(words))
        time.sleep(2.0)
        times = probe(running, effort.turns * effort.turn_s / 3.0, ports)
    return list(_slices([times[str(port)] for port in ports], effort.turns))


def _slices(times: Sequence[Sequence[float]], turns: int) -> Iterator[Turn]:
    """Yield the medians of the answers in each slice of the time; -1 is none."""
    size = len(times[0]) // turns
    for first in range(0, turns * size, size):
        found = [[one for one in each[first : first + size] if one >= 0.0] for each in times]
        if all(found):
            yield Turn(*map(median, found))
