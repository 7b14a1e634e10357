"""Around a tick: the warm-up before the first one, and what made one late."""

from __future__ import annotations

import asyncio
import gc
import math
from contextlib import ExitStack
from dataclasses import replace

import pytest

from adaptdrive.app.ports import build_port
from adaptdrive.app.process import WarmUp
from adaptdrive.config import load_configuration
from adaptdrive.config.services import Realtime
from adaptdrive.runtime.realtime import real_time
from adaptdrive.runtime.tick_support import COLLECT_TICKS, IdleCollector, LatencyDetector
from adaptdrive.safety.facts import Reading
from tests.loopback_port import LoopbackPort
from tests.unit.devices.bench import EXAMPLES
from tests.unit.runtime.bench import CALM, TICK_S, FastBench, fast_bench


def test_the_warm_up_leaves_the_bus_alone() -> None:
    path = EXAMPLES / "motor.toml"
    configuration = load_configuration(path)
    port = build_port(configuration, lambda: 0.0, path)
    ticks = WarmUp(configuration, port).run()
    assert ticks > 3 * configuration.ticks_per_period
    assert port.statistics.sent == 0
    assert port.statistics.send_drops >= ticks


class LateReader(LoopbackPort):
    """A port whose frames nobody looks at until it is asked to catch up."""

    waiting: Reading | None = None

    def catch_up(self) -> None:
        if self.waiting is not None:
            reading, self.waiting = self.waiting, None
            self.deliver(reading)


async def overslept(bench: FastBench, half_cycles: int) -> None:
    """The timer wakes the loop after so many half cycles, whose frames all wait to be read."""
    around, port = bench.around, LateReader(bench.sent.append)
    bench.loop._port = port
    serving = asyncio.create_task(port.run(bench, lambda: None))
    await asyncio.sleep(0)
    newest_s = around.now + half_cycles * TICK_S
    around.now = newest_s + 0.3 * TICK_S
    waiting = replace(CALM, arrival_s=newest_s, oldest_s=newest_s, bridge=True)
    port.waiting = replace(waiting, counter=bench.counter + half_cycles)
    bench.loop.on_deadline(around.deadline_s)
    serving.cancel()
    await asyncio.wait([serving])


async def test_what_was_overslept_reaches_the_filters_as_a_drive_that_skipped_it() -> None:
    """The same half cycles lost on the bus instead: controller and filters end up the same."""
    async with fast_bench() as bench, fast_bench() as other:
        bench.start()
        other.start()
        ticks, sent = bench.loop.ticks, len(bench.sent)
        await overslept(bench, 5)
        assert (bench.loop.ticks, len(bench.sent)) == (ticks + 1, sent + 1)
        assert (bench.loop.missed, bench.loop.held) == (4, 0)
        assert bench.around.deadline_s > bench.around.now
        other.around.deadline_s = math.inf
        other.measured = CALM
        other.frame(after_s=5 * TICK_S, steps=5, bridge=True)
        mine, others = bench.controller.inner, other.controller.inner
        assert bench.loop.tick == other.loop.tick
        assert mine._bank == others._bank
        assert repr(mine._fast) == repr(others._fast)  # a NaN equals none


class Detected:
    """A detector whose clocks go as a test has them."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.now_s = self.used_s = 1000.0
        self.detector = LatencyDetector(self.told.append, lambda: self.now_s, lambda: self.used_s)


@pytest.mark.parametrize(
    ("used_s", "tick_us", "told"),
    [
        (0.03, 20.0, "the daemon itself used 29.98 ms of processor time since the tick before"),
        (0.009, 8900.0, "nothing of the daemon ran"),  # it took long itself
        (0.0, 0.0, "nothing of the daemon ran"),
    ],
)
def test_a_callback_that_blocks_is_told_by_its_processor_time(
    used_s: float, tick_us: float, told: str
) -> None:
    seen = Detected()
    seen.detector.ticked(1999.0, 20.0)
    seen.used_s += used_s
    seen.detector.ticked(6000.0, tick_us)
    (sentence,) = seen.told
    assert sentence.startswith(f"tick 6.00 ms late: {told}")


def test_many_late_ticks_are_told_once_and_counted() -> None:
    seen = Detected()
    for _ in range(500):
        seen.now_s += 0.008
        seen.detector.ticked(3000.0, 20.0)
    assert len(seen.told) == 1
    seen.now_s += 60.0
    seen.detector.ticked(2500.0, 20.0)
    assert "499 more" in seen.told[1]
    assert "the worst 3.00 ms late" in seen.told[1]


def test_after_the_freeze_garbage_waits_for_the_collector() -> None:
    class Knot:
        def __init__(self) -> None:
            self.itself = self

    collected: list[int] = []
    collector = IdleCollector()
    with real_time(Realtime()) as grants, ExitStack() as stack:
        assert grants == []
        assert not gc.isenabled()
        knot = Knot()
        gc.callbacks.append(lambda _, info: collected.append(info.get("collected", 0)))
        stack.callback(gc.callbacks.pop)
        del knot
        due = [collector.is_due() for _ in range(2 * COLLECT_TICKS)]
        assert [n for n, one in enumerate(due, 1) if one] == [COLLECT_TICKS, 2 * COLLECT_TICKS]
        assert collector.collect(idle=False) == 0
        assert collected[-1] > 0
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def test_a_full_collection_waits_until_the_drive_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    collector, collected = IdleCollector(), list[int]()
    monkeypatch.setattr(gc, "collect", collected.append)
    running = [collector.collect(idle=False) for _ in range(7000)]
    assert running[:20].count(1) == 2
    assert max(running) == 1
    assert collector.collect(idle=True) == 2
    assert collector.collect(idle=True) < 2
    assert collected[:-1] == [*running, 2]
