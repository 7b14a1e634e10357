"""Processor time and memory of daemons beside the script of an afternoon, on the same frames.

The daemons of both builds, two scripts and two bare echoes run at the same time, so that whatever
else the machine does meets them alike.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support import resident_MiB
from tools.benchmarks.daemons import run_drives
from tools.benchmarks.paired.pairs import Effort, Row, Turn
from tools.benchmarks.site import broker, start_daemon
from tools.benchmarks.tools import bus_ports, cpu_s, process
from tools.builds.run import COMPILED, PURE

SHARE, RESIDENT = "daemon with its log, processor", "the same, memory"
SCRIPT, ECHO = "the script", "a bare echo"
MOST_RATIO = {PURE: 1.0, COMPILED: 0.8}
"""Processor time of a daemon over that of the script."""


def rows(environments: dict[str, dict[str, str]], effort: Effort) -> Iterator[Row]:
    """Rows of all builds."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        _, broker_port = stack.enter_context(broker(folder))
        ports = bus_ports(len(environments) + 4)
        others = [_other(stack, number, port, broker_port, folder)
                  for number, port in enumerate(ports[-4:])]  # fmt: skip
        daemons = []
        for i, (environment, port) in enumerate(zip(environments.values(), ports, strict=False)):
            changes, home = {"drive.name": f'"d{i}"'}, folder / f"d{i}"
            daemons.append(start_daemon(stack, home, port, broker_port, changes, environment))
        run_drives(stack, daemons, ports[-4:], folder / "late")
        pids = [*(one.daemon.pid for one in daemons), *others]
        shares, sizes = _measured(pids, effort)
    for i, build in enumerate(environments):
        script, echo = _turns(shares, i, -4), _turns(shares, i, -2)
        yield Row(SHARE, build, "%", SCRIPT, script, most_ratio=MOST_RATIO[build])
        yield Row(SHARE, build, "%", ECHO, echo)
        yield Row(RESIDENT, build, "MiB", SCRIPT, _turns(sizes, i, -4), most=80.0)


def _other(stack: ExitStack, number: int, port: int, broker_port: int, folder: Path) -> int:
    """Start two scripts, then two echoes; return the process."""
    of = [sys.executable, "-m"]
    script = [*of, "tools.benchmarks.paired.script", str(port), str(broker_port)]
    echo = [*of, "tools.benchmarks.echo", str(port)]
    command = echo if number > 1 else [*script, str(folder / f"{number}.csv")]
    return stack.enter_context(process(command)).pid


def _measured(pids: Sequence[int], effort: Effort) -> tuple[list[list[float]], list[list[float]]]:
    """Return processor time, in percent, and memory of each process in each turn."""
    shares, sizes = [], []
    for _ in range(effort.turns):
        before, began_s = list(map(cpu_s, pids)), time.monotonic()
        time.sleep(effort.turn_s)
        after, passed_s = list(map(cpu_s, pids)), time.monotonic() - began_s
        shares.append([100.0 * (b - a) / passed_s for a, b in zip(before, after, strict=True)])
        sizes.append(list(map(resident_MiB, pids)))
    return shares, sizes


def _turns(measured: list[list[float]], ours: int, reference: int) -> list[Turn]:
    return [Turn(one[ours], one[reference], one[reference + 1]) for one in measured]
