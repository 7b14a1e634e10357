"""The latency detector: does it say whether the daemon itself made a tick late?"""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable

from adaptdrive.clock.tick_timer import TickTimer
from adaptdrive.runtime.latency import LatencyDetector

BLOCK_S = 0.03


class Witness:
    """A timer's tick that is delayed by something, and what the detector said of it."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.told: list[str] = []
        self.detector = LatencyDetector(5000.0, self.told.append, time.monotonic)
        self.detector.open()
        self.ticked = loop.create_future()
        self.timer = TickTimer(loop, self._tick)

    def _tick(self, deadline_s: float) -> None:
        self.detector.ticked((time.monotonic() - deadline_s) * 1e6, 0.0)
        self.ticked.set_result(None)

    async def tick_during(self, culprit: Callable[[], object]) -> str:
        self.detector.ticked(0.0, 0.0)
        self.timer.arm(time.monotonic() + 0.002)
        culprit()
        await self.ticked
        self.detector.close()
        self.timer.close()
        (sentence,) = self.told
        return sentence


def compute() -> None:
    end_s = time.process_time() + BLOCK_S
    while time.process_time() < end_s:
        pass


async def test_a_callback_that_blocks_is_told_by_its_processor_time() -> None:
    loop = asyncio.get_running_loop()
    sentence = await Witness(loop).tick_during(lambda: loop.call_soon(compute))
    _, _, told = sentence.partition(" ms late: the daemon itself used ")
    assert float(told.split(" ms of processor time")[0]) >= BLOCK_S * 1e3


async def test_a_collection_is_told_by_its_time() -> None:
    class Slow:
        """Collected, it takes its time."""

        def __init__(self) -> None:
            self.itself = self

        def __del__(self) -> None:
            compute()

    slow = Slow()
    del slow
    sentence = await Witness(asyncio.get_running_loop()).tick_during(gc.collect)
    collected_ms = sentence.removesuffix(" ms of it to collect garbage").split()[-1]
    assert float(collected_ms) >= BLOCK_S * 1e3


async def test_a_loop_that_slept_is_not_blamed() -> None:
    sentence = await Witness(asyncio.get_running_loop()).tick_during(lambda: time.sleep(BLOCK_S))
    assert "nothing of the daemon ran" in sentence


def test_a_tick_that_took_long_itself_is_not_blamed_for_its_lateness() -> None:
    told: list[str] = []
    used_s = iter([0.0, 0.009])
    detector = LatencyDetector(5000.0, told.append, lambda: 1000.0, lambda: next(used_s))
    detector.ticked(6000.0, 8900.0)
    assert "nothing of the daemon ran" in told[0]


def test_many_late_ticks_are_told_once_and_counted() -> None:
    told: list[str] = []
    now = [1000.0]
    detector = LatencyDetector(2000.0, told.append, lambda: now[0])
    for _ in range(500):
        now[0] += 0.008
        detector.ticked(3000.0, 20.0)
    assert len(told) == 1
    now[0] += 60.0
    detector.ticked(2500.0, 20.0)
    assert "499 more" in told[1]
    assert "the worst 3.00 ms late" in told[1]


def test_a_tick_in_time_is_not_worth_a_word() -> None:
    told: list[str] = []
    detector = LatencyDetector(2000.0, told.append, lambda: 1000.0)
    detector.ticked(1999.0, 20.0)
    assert told == []
