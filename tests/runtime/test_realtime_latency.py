"""The latency detector: does it name who really made a tick late?"""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable

from adaptdrive.clock.tick_timer import TickTimer
from adaptdrive.runtime.latency import LatencyDetector, WatchedLoop

BLOCK_S = 0.03


class Witness:
    """A timer's tick that is delayed by something, and what the detector said of it."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.told: list[str] = []
        ring = loop.ring if isinstance(loop, WatchedLoop) else None
        self.detector = LatencyDetector(5000.0, self.told.append, time.monotonic, ring)
        self.detector.open()
        self.ticked = loop.create_future()
        self.timer = TickTimer(loop, self._tick)

    def _tick(self, deadline_s: float) -> None:
        self.detector.ticked((time.monotonic() - deadline_s) * 1e6, 0.0)
        self.ticked.set_result(None)

    async def tick_during(self, culprit: Callable[[], object]) -> list[str]:
        self.timer.arm(time.monotonic() + 0.002)
        culprit()
        await self.ticked
        self.detector.close()
        self.timer.close()
        return self.told


def block() -> None:
    time.sleep(BLOCK_S)


def test_a_task_that_blocks_is_named() -> None:
    async def careless(witness: Witness) -> None:
        await asyncio.sleep(0)
        block()

    async def main() -> list[str]:
        witness = Witness(asyncio.get_running_loop())
        task = asyncio.create_task(careless(witness), name="careless")
        told = await witness.tick_during(lambda: None)
        await task
        return told

    with asyncio.Runner(loop_factory=WatchedLoop) as runner:
        (sentence,) = runner.run(main())
    assert "ms late: task 'careless' " in sentence


def test_a_callback_that_blocks_is_named() -> None:
    async def main() -> list[str]:
        loop = asyncio.get_running_loop()
        witness = Witness(loop)
        return await witness.tick_during(lambda: loop.call_soon(block))

    with asyncio.Runner(loop_factory=WatchedLoop) as runner:
        (sentence,) = runner.run(main())
    assert "ms late: block " in sentence


def test_a_collection_is_named() -> None:
    class Slow:
        """Collected, it takes its time."""

        def __init__(self) -> None:
            self.itself = self

        def __del__(self) -> None:
            block()

    async def main() -> list[str]:
        witness = Witness(asyncio.get_running_loop())
        slow = Slow()
        del slow
        return await witness.tick_during(gc.collect)

    with asyncio.Runner(loop_factory=WatchedLoop) as runner:
        (sentence,) = runner.run(main())
    assert "ms late: garbage collection " in sentence


def test_a_loop_that_slept_is_not_blamed() -> None:
    told: list[str] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, WatchedLoop)
        detector = LatencyDetector(5000.0, told.append, time.monotonic, loop.ring)
        await asyncio.sleep(0.05)
        detector.ticked(30_000.0, 0.0)

    with asyncio.Runner(loop_factory=WatchedLoop) as runner:
        runner.run(main())
    (sentence,) = told
    assert "nothing of the daemon ran" in sentence


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


def test_the_watched_loop_runs_processes_like_any_other() -> None:
    async def main() -> int:
        process = await asyncio.create_subprocess_exec("true")
        return await process.wait()

    with asyncio.Runner(loop_factory=WatchedLoop) as runner:
        assert runner.run(main()) == 0
