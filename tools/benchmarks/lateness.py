"""Lateness of ticks on the timer against cyclictest: same period, same priority.

They take turns for the quantiles. For rare late ticks both run at once, so that they suffer
from the same things.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from tools.benchmarks.rows import Extent, Row, quantile
from tools.benchmarks.tools import PRIORITY, run_json, try_fifo

PERIOD_US = 8333
_ROUNDS = 6
_ROUND_S = 10.0
"""How long one of them runs before it is the other's turn."""

PLAIN = "idle CPUs asleep"
AWAKE = "cpu_latency_us = 0"
_WAYS = {PLAIN: False, AWAKE: True}
"""Whether idle CPUs are kept awake, as cyclictest keeps them."""

SHARES = ((0.50, "p50"), (0.99, "p99"), (0.999, "p99.9"), (1.0, "max"))


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    if shutil.which("cyclictest") is None:
        raise RuntimeError("cyclictest is missing; Debian has it in rt-tests")
    priority = PRIORITY if _fifo_is_granted() else 0
    seconds = extent.pick(_ROUND_S, 4.0, 0.5)
    rounds = extent.pick(_ROUNDS, 2, 1)
    peer: list[float] = []
    ours: dict[str, list[float]] = {how: [] for how in _WAYS}
    for _ in range(rounds):
        peer += cyclictest(seconds, priority)
        for how, awake in _WAYS.items():
            found = run_json("tools.benchmarks.timer_ticks", seconds, priority, int(awake))
            ours[how] += found["lateness_us"]
    limit = 2.0 * quantile(peer, 0.99) + 100.0
    yield from _compared(AWAKE, ours[AWAKE], peer, f"at most {limit:.0f} us (2 x + 100)", limit)
    yield from _compared(PLAIN, ours[PLAIN], peer)
    yield _rare(60.0 * extent.pick(extent.minutes, 0.2, 0.01), priority)


def _rare(seconds: float, priority: int) -> Row:
    """Ticks later than half a period, of ours and of cyclictest's in the same minutes."""
    with ThreadPoolExecutor(1) as beside:
        running = beside.submit(cyclictest, seconds, priority)
        ours = run_json("tools.benchmarks.timer_ticks", seconds, priority, 1)["lateness_us"]
        peer = running.result()
    late, held = (sum(one > 0.5 * PERIOD_US for one in times) for times in (ours, peer))
    scheduling = f"SCHED_FIFO {priority}" if priority else "ordinary scheduling"
    note = f"of {len(ours)} ticks, {scheduling}; the latest by {max(ours):.0f} us, "
    note += f"cyclictest's by {max(peer):.0f} us"
    target, met = "no more than cyclictest's", late <= held
    name = "ticks later than half a period"
    return Row(name, float(late), "", float(held), "cyclictest, at once", target, met, note)


def _compared(
    how: str, ours: list[float], peer: list[float], target: str = "", limit: float = 0.0
) -> Iterator[Row]:
    for share, name in SHARES:
        found, held = quantile(ours, share), quantile(peer, share)
        wanted, met = (target, found <= limit) if target and name == "p99" else ("", None)
        yield Row(f"tick lateness {name}, {how}", found, "us", held, "cyclictest", wanted, met)


def _fifo_is_granted() -> bool:
    child = os.fork()
    if not child:
        os._exit(0 if try_fifo(PRIORITY) else 1)
    return os.waitpid(child, 0)[1] == 0


def cyclictest(seconds: float, priority: int, *, tuning: bool = True) -> list[float]:
    """Lateness of every wake-up of cyclictest, in whole microseconds.

    Args:
        seconds: How long it runs.
        priority: Of SCHED_FIFO, 0 for ordinary scheduling.
        tuning: Whether it keeps idle CPUs awake, as it does unless told otherwise.
    """
    command = ["cyclictest", "-t1", f"-i{PERIOD_US}", f"-l{round(seconds * 1e6 / PERIOD_US)}"]
    command += ["-q", "-m", "-h", "100000", f"-p{priority}"]
    command += [] if tuning else ["--default-system"]
    run = subprocess.run(command, check=False, capture_output=True, text=True)
    found: list[float] = []
    for late_us, count in re.findall(r"^(\d{6})\s+(\d+)\s*$", run.stdout, re.MULTILINE):
        found += [float(late_us)] * int(count)
    if not found:
        raise RuntimeError(f"cyclictest: {run.stderr.strip() or run.stdout.strip()}")
    return found
