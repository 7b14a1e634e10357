"""The half cycles of a simulated drive in real time, on an absolute grid that follows the line."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator

from adaptdrive.util.clock import TickTimer
from adaptdrive_sim.devices.drive import Frame, Report, SimulatedDrive

STALL_s = 1.0
"""A process that slept longer than this (a suspended machine) starts a new grid."""


async def run_half_cycles(
    drive: SimulatedDrive,
    clock: Callable[[], float],
    deliver: Callable[[Frame], None],
    report: Report,
) -> None:
    """Run one half cycle after the other until cancelled.

    Args:
        drive: What lives through them.
        clock: Monotonic clock in seconds.
        deliver: Given the last frame of those that have passed.
        report: Takes a report of a process that slept.
    """
    expired = asyncio.Event()
    deadline_s = clock() + drive.world.line.half_cycle_s
    with _timer(expired) as timer:
        while True:
            timer.arm(deadline_s)
            await expired.wait()
            expired.clear()
            now_s = clock()
            if now_s - deadline_s > STALL_s:
                report("stalled", seconds=round(now_s - deadline_s, 3))
                deadline_s = now_s
            deadline_s = _catch_up(drive, now_s, deadline_s, deliver)


def _catch_up(
    drive: SimulatedDrive, now_s: float, deadline_s: float, deliver: Callable[[Frame], None]
) -> float:
    """Run every half cycle that has passed and deliver the last one; the next deadline."""
    frame: Frame | None = None
    while deadline_s <= now_s:
        frame = drive.tick(now_s)
        deadline_s += frame.sample.tick_period_s
    if frame is not None:
        deliver(frame)
    return deadline_s


@contextlib.contextmanager
def _timer(expired: asyncio.Event) -> Iterator[TickTimer]:
    timer = TickTimer(asyncio.get_running_loop(), lambda _: expired.set())
    try:
        yield timer
    finally:
        timer.close()
