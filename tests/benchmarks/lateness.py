"""Lateness of ticks on the timer against cyclictest: same period, same priority, taking turns."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator

from tests.benchmarks.rows import Extent, Row, quantile
from tests.benchmarks.tools import PRIORITY, run_json, try_fifo

PERIOD_US = 8333
SPIN_US = 300
_ROUND_S = 10.0
"""How long one of them runs before it is the other's turn."""

SHARES = ((0.50, "p50"), (0.99, "p99"), (0.999, "p99.9"), (1.0, "max"))


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    if shutil.which("cyclictest") is None:
        raise RuntimeError("cyclictest is missing; Debian has it in rt-tests")
    priority = PRIORITY if _fifo_is_granted() else 0
    seconds = 4.0 if extent.quick else _ROUND_S
    rounds = 2 if extent.quick else max(1, round(60.0 * extent.minutes / seconds))
    ours: list[float] = []
    spun: list[float] = []
    peer: list[float] = []
    for _ in range(rounds):
        ours += run_json("tests.benchmarks.timer_ticks", seconds, priority, 0)["lateness_us"]
        peer += cyclictest(seconds, priority)
        spun += run_json("tests.benchmarks.timer_ticks", seconds, priority, SPIN_US)["lateness_us"]
    scheduling = f"SCHED_FIFO {priority}" if priority else "ordinary scheduling"
    note = f"{len(ours)} ticks, {scheduling}"
    limit = 2.0 * quantile(peer, 0.99) + 100.0
    late = quantile(ours, 0.99)
    for share, name in SHARES:
        target = {"p99": f"at most {limit:.0f} us (2 x + 100)"}.get(name, "")
        met = late <= limit if name == "p99" else None
        found, held = quantile(ours, share), quantile(peer, share)
        yield Row(f"tick lateness {name}", found, "us", held, "cyclictest", target, met, note)
    for share, name in SHARES:
        found, held = quantile(spun, share), quantile(peer, share)
        target = "at most cyclictest's" if name == "p99" else ""
        met = found <= held if name == "p99" else None
        label = f"tick lateness {name}, spinning {SPIN_US} us"
        yield Row(label, found, "us", held, "cyclictest", target, met, note)


def _fifo_is_granted() -> bool:
    child = os.fork()
    if not child:
        os._exit(0 if try_fifo(PRIORITY) else 1)
    return os.waitpid(child, 0)[1] == 0


def cyclictest(seconds: float, priority: int) -> list[float]:
    """Lateness of every wake-up of cyclictest, in whole microseconds."""
    command = ["cyclictest", "-t1", f"-i{PERIOD_US}", f"-l{round(seconds * 1e6 / PERIOD_US)}"]
    command += ["-q", "-m", "-h", "100000", f"-p{priority}"]
    run = subprocess.run(command, check=False, capture_output=True, text=True)
    found: list[float] = []
    for late_us, count in re.findall(r"^(\d{6})\s+(\d+)\s*$", run.stdout, re.MULTILINE):
        found += [float(late_us)] * int(count)
    if not found:
        raise RuntimeError(f"cyclictest: {run.stderr.strip() or run.stdout.strip()}")
    return found
