"""Ticks that are missed, a timer that spins, and memory that stays flat."""

from __future__ import annotations

import asyncio
import gc
import time
from pathlib import Path

import pytest

from adaptdrive.app.ports import build_port
from adaptdrive.app.warm_up import warm_up
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.tick_timer import TickTimer
from tests.runtime.bench import MOTOR, TICK_S, FastBench, fast_bench, until

EXAMPLE = Path(__file__).parents[2] / "deploy" / "examples" / "motor.toml"


async def test_missed_half_cycles_are_counted_and_not_made_up() -> None:
    """A loop that slept for three half cycles runs one tick, on the grid, and no burst."""
    async with fast_bench() as bench:
        bench.start()
        ticks, sent = bench.loop.counts.ticks, len(bench.sent)
        bench.around.now += 3.0 * TICK_S
        bench.loop.on_deadline(bench.around.deadline_s - 3.0 * TICK_S)
        assert bench.loop.counts.ticks == ticks + 1
        assert len(bench.sent) == sent + 1
        assert bench.around.deadline_s > bench.around.now


async def test_a_drive_that_skips_half_cycles_costs_one_tick_each_time() -> None:
    async with fast_bench() as bench:
        bench.start()
        ticks, missed = bench.loop.counts.ticks, bench.loop.counts.missed
        bench.around.deadline_s = float("inf")
        bench.frame(after_s=3.0 * TICK_S, steps=3)
        assert bench.loop.counts.missed >= missed
        assert bench.loop.counts.ticks > ticks
        assert bench.state() is State.RUNNING


async def test_each_tick_tells_how_long_it_took() -> None:
    async with fast_bench() as bench:
        bench.start()
        assert all(report.tick_us >= 0.0 for report in bench.reports)
        assert bench.loop.tick_time.take().max >= 0.0


async def test_a_spinning_timer_is_never_early_and_still_expires_once() -> None:
    times_s: list[float] = []
    loop = asyncio.get_running_loop()
    timer = TickTimer(loop, lambda _: times_s.append(time.monotonic()), spin_s=0.001)
    deadline_s = time.monotonic() + 0.02
    timer.arm(deadline_s)
    await until(lambda: bool(times_s))
    await asyncio.sleep(0.01)
    timer.close()
    assert len(times_s) == 1
    assert times_s[0] >= deadline_s


def test_the_rehearsal_leaves_the_bus_alone() -> None:
    port = build_port(MOTOR, time.monotonic, EXAMPLE)
    ticks = warm_up(MOTOR, port)
    assert ticks > 3 * MOTOR.ticks_per_period
    assert port.statistics.sent == 0
    assert port.statistics.send_drops >= ticks


def resident_pages() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])


@pytest.mark.slow
@pytest.mark.timeout(900)
async def test_memory_is_flat_over_an_hour_of_ticks() -> None:
    """Ten minutes to settle, then fifty: what grows with each tick would show as megabytes."""
    async with fast_bench() as bench:
        bench.start()
        await _minutes(bench, 10)
        gc.collect()
        before, objects = resident_pages(), len(gc.get_objects())
        await _minutes(bench, 50)
        gc.collect()
        grown_KiB = 4 * (resident_pages() - before)
        assert bench.state() is State.RUNNING
        assert bench.loop.counts.missed == 0
        assert len(gc.get_objects()) - objects < 1000
        assert grown_KiB < 2048


async def _minutes(bench: FastBench, count: int) -> None:
    for _ in range(count * 60):
        bench.frames(120)
        for snapshot in bench.around.snapshots:
            bench.loop.deliver(snapshot, bench.loop._controller.decide(snapshot))
        bench.sent[:-1] = []
        bench.around.reports.clear()
        bench.around.snapshots.clear()
        bench.around.decisions.clear()
        bench.around.fed.clear()
