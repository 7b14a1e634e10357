"""Which ticks may feed the watchdog: those that met their deadline, whatever clock drives them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.runtime.loop_interface import FastLoopSettings
from tests.runtime.bench import FAST, TICK_S, FastBench, fast_bench

TIMERLESS = replace(FAST, timer_standin=False)
POLLED = replace(FAST, timing=replace(FAST.timing, ticks_per_reading=12))
EACH_CLOCK = pytest.mark.parametrize("settings", [FAST, TIMERLESS], ids=["stand-in", "timerless"])


def frame_that_waited(bench: FastBench, seconds: float) -> None:
    """Let time pass while nothing runs, and a frame be read afterwards, before the timer."""
    now_s = bench.around.now = bench.around.deadline_s + seconds
    bench.counter += 6
    reading = replace(bench.measured, arrival_s=now_s, oldest_s=now_s, counter=bench.counter)
    bench.port.deliver(reading)


@EACH_CLOCK
async def test_each_frame_in_time_feeds(settings: FastLoopSettings) -> None:
    async with fast_bench(settings) as bench:
        bench.frames(20)
        assert len(bench.around.fed) == 20


@EACH_CLOCK
async def test_a_silent_drive_starves_nobody(settings: FastLoopSettings) -> None:
    async with fast_bench(settings) as bench:
        bench.frames(5)
        fed = len(bench.around.fed)
        bench.wait(100 * TICK_S)
        assert len(bench.around.fed) - fed >= 98


@EACH_CLOCK
async def test_a_deadline_that_was_overslept_does_not_feed(settings: FastLoopSettings) -> None:
    async with fast_bench(settings) as bench:
        bench.frames(5)
        fed = list(bench.around.fed)
        bench.oversleep(0.6 * TICK_S)
        bench.oversleep(30.0 * TICK_S)
        assert bench.around.fed == fed
        bench.oversleep(0.1 * TICK_S)
        assert len(bench.around.fed) == len(fed) + 1


@EACH_CLOCK
async def test_a_frame_that_waited_for_the_loop_does_not_feed(settings: FastLoopSettings) -> None:
    """It is stamped when the loop comes to read it, so that its own tick looks punctual."""
    async with fast_bench(settings) as bench:
        bench.frames(5)
        fed = list(bench.around.fed)
        for _ in range(10):
            frame_that_waited(bench, 5.0 * TICK_S)
        assert bench.around.fed == fed
        bench.frame()
        assert len(bench.around.fed) == len(fed) + 1


@EACH_CLOCK
async def test_ticks_that_take_too_long_do_not_feed(
    settings: FastLoopSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with fast_bench(settings) as bench:
        bench.frames(5)
        fed = list(bench.around.fed)
        bench.slow_down(monkeypatch, 0.7 * TICK_S)
        bench.frames(5, after_s=0.3 * TICK_S)
        assert bench.around.fed == fed


async def test_polls_are_judged_by_the_period_of_the_polls(monkeypatch: pytest.MonkeyPatch) -> None:
    async with fast_bench(POLLED) as bench:
        bench.slow_down(monkeypatch, 5.0 * TICK_S)
        bench.frame(after_s=12 * TICK_S, steps=12)
        fed = len(bench.around.fed)
        assert fed
        bench.slow_down(monkeypatch, 2.0 * TICK_S)
        bench.frame(after_s=12 * TICK_S, steps=12)
        assert len(bench.around.fed) == fed
