"""Figures of a process that must stay flat, and the table of their trends."""

from __future__ import annotations

import os
import sys
import threading
import tracemalloc
from array import array
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from tests.support import resident_MiB
from tools.soak.flat import COUNT, OBJECTS, Limit, MEMORY_MiB, Trend, trend

LIMITS: dict[str, Limit] = {
    "resident memory, MiB": MEMORY_MiB,
    "traced memory, MiB": MEMORY_MiB,
    "blocks of memory": OBJECTS,
    "descriptors": COUNT,
    "threads": COUNT,
}
HEAD = (
    "| process | figure | after the warm-up | median | end | gain (limit) | per hour | |",
    "|---|---|---|---|---|---|---|---|",
)


def of_process(pid: int) -> dict[str, float]:
    """Return the figures of another process, as the kernel has them."""
    process = Path("/proc") / str(pid)
    return {
        "resident memory, MiB": resident_MiB(pid),
        "descriptors": float(len(list((process / "fd").iterdir()))),
        "threads": float(len(list((process / "task").iterdir()))),
    }


def of_this() -> dict[str, float]:
    """Return the figures of this process, with what only its interpreter knows."""
    found = of_process(os.getpid())
    found["blocks of memory"] = float(sys.getallocatedblocks())
    found["threads"] = float(threading.active_count())
    if tracemalloc.is_tracing():
        found["traced memory, MiB"] = tracemalloc.get_traced_memory()[0] / 2**20
    return found


class Meter:
    """The figures of one process over a run."""

    def __init__(self, name: str, look: Callable[[], Mapping[str, float]]) -> None:
        """Measure nothing yet.

        Args:
            name: Of the process.
            look: Measures it.
        """
        self.name = name
        self._look = look
        self._hours = array("d")  # one block of memory, which is metered too
        self._values: dict[str, array[float]] = {}

    def look(self, hours: float) -> None:
        """Measure it once.

        Args:
            hours: Time since the start of the run.
        """
        found = self._look()
        self._hours.append(hours)
        for figure, value in found.items():
            self._values.setdefault(figure, array("d")).append(value)

    def trends(self) -> dict[str, Trend]:
        """Return the trend of each figure."""
        return {
            figure: trend(self._hours, values, LIMITS[figure])
            for figure, values in self._values.items()
        }

    def lines(self) -> Iterator[str]:
        """Yield a line of the table for each figure."""
        for figure, one in self.trends().items():
            verdict = "flat" if one.flat else "GROWS"
            numbers = " | ".join(f"{value:.6g}" for value in (one.first, one.median, one.last))
            gain = f"{one.gain:+.3g} ({one.limit:.3g})"
            rest = f"{gain} | {one.per_hour:+.3g} | {verdict}"
            yield f"| {self.name} | {figure} | {numbers} | {rest} |"
