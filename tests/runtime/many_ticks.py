"""Ticks as fast as they go: five minutes to settle, then what twenty leave behind.

It prints one object of JSON. Memory of a process that has done other things before tells nothing.
"""

from __future__ import annotations

import asyncio
import gc
import json
import os
import sys
from pathlib import Path
from typing import Any

from tests.runtime.bench import TICK_S, FastBench, running_bench

SETTLE_MINUTES, MINUTES = 5, 20


async def _run() -> dict[str, Any]:
    async with running_bench() as bench:
        _minutes(bench, SETTLE_MINUTES)
        before_KiB, objects_before = _in_use()
        _minutes(bench, MINUTES)
        after_KiB, objects_after = _in_use()
        return {
            "state": bench.state(),
            "missed": bench.loop.counts.missed,
            "grown_KiB": after_KiB - before_KiB,
            "grown_objects": objects_after - objects_before,
        }


def _in_use() -> tuple[int, int]:
    """Resident memory in KiB, and objects that the collector knows."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024, len(gc.get_objects())


def _minutes(bench: FastBench, count: int) -> None:
    for _ in range(count * 60):
        bench.frames(round(1.0 / TICK_S))
        for snapshot in bench.around.snapshots:
            bench.loop.deliver(snapshot, bench.controller.decide(snapshot))
        bench.sent[:-1] = []
        bench.around.reports.clear()
        bench.around.snapshots.clear()
        bench.around.decisions.clear()
        bench.around.fed.clear()


if __name__ == "__main__":
    sys.stdout.write(json.dumps(asyncio.run(_run())))
