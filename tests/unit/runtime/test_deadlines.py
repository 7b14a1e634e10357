"""What the fast loop counts and times, and which ticks may feed the watchdog: those in time."""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from tests.unit.runtime.bench import FAST, TICK_S, fast_bench, running_bench, timed

POLLS = replace(FAST, timing=replace(FAST.timing, ticks_per_reading=12))


async def test_polls_are_judged_by_the_period_of_the_polls(monkeypatch: pytest.MonkeyPatch) -> None:
    async with fast_bench(POLLS) as bench:
        bench.slow_down(monkeypatch, 5.0 * TICK_S)
        bench.frame(after_s=12 * TICK_S, steps=12)
        fed = len(bench.around.fed)
        assert fed
        bench.slow_down(monkeypatch, 2.0 * TICK_S)
        bench.frame(after_s=12 * TICK_S, steps=12)
        assert len(bench.around.fed) == fed


async def test_frames_in_time_and_the_deadlines_of_a_silent_drive_feed() -> None:
    async with fast_bench() as bench:
        bench.frames(20)
        assert len(bench.around.fed) == 20
        bench.wait(100 * TICK_S)
        assert len(bench.around.fed) >= 118


async def test_what_comes_half_a_period_late_or_takes_as_long_does_not_feed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A frame that waited is stamped when the loop reads it, so that its tick looks punctual."""
    async with fast_bench(timed(half_cycle_s=EXACT_S)) as bench:
        bench.around.now = 1024.0
        bench.frames(5, after_s=EXACT_S)
        fed = list(bench.around.fed)
        bench.oversleep(0.5 * EXACT_S)
        bench.oversleep(30.0 * EXACT_S)
        for _ in range(10):
            bench.thaw(6.0 * EXACT_S)
        assert bench.around.fed == fed
        bench.oversleep(0.1 * EXACT_S)
        assert len(bench.around.fed) == len(fed) + 1
        bench.slow_down(monkeypatch, 0.7 * EXACT_S)
        bench.frames(5, after_s=0.3 * EXACT_S)
        assert len(bench.around.fed) == len(fed) + 1


STRIDE = 12
POLLED = replace(FAST, timing=replace(FAST.timing, ticks_per_reading=STRIDE), drive_clocks=False)
EXACT_S = 2.0**-7
"""A half cycle whose multiples are exact."""


@pytest.mark.parametrize("known", [1, 5])
async def test_a_frame_that_was_lost_is_a_missed_half_cycle(known: int) -> None:
    async with fast_bench() as bench:
        bench.frames(known)
        bench.thaw(3 * TICK_S)
        assert bench.ticks == [*range(known), known + 2]
        assert bench.loop.missed == 2


async def test_polls_that_the_machine_overslept_are_missed() -> None:
    async with fast_bench(POLLED, modulus=None) as bench:
        bench.frames(3, after_s=STRIDE * TICK_S, counter=None)
        bench.oversleep(4.5 * STRIDE * TICK_S)
        assert bench.ticks == [0, STRIDE, 2 * STRIDE, 7 * STRIDE]
        assert bench.loop.missed == 4


async def test_a_tick_is_timed_from_its_frame_to_its_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with fast_bench() as bench:
        bench.frames(5)
        for window in (bench.loop.lateness, bench.loop.tick_time, bench.loop.turnaround):
            window.take()
        bench.slow_down(monkeypatch, 0.001)
        bench.frame(arrival_s=bench.around.now + TICK_S - 0.002)
        report = bench.reports[-1]
        times_us = report.lateness_us, report.tick_us, report.turnaround_us
        assert times_us == pytest.approx((2000.0, 1000.0, 3000.0), rel=1e-8)
        assert bench.loop.lateness.take().max == report.lateness_us
        assert bench.loop.tick_time.take().max == report.tick_us
        assert bench.loop.turnaround.take().max == report.turnaround_us
        assert report.time_s == bench.around.now


async def test_a_command_that_is_held_to_a_limit_is_counted() -> None:
    async with running_bench() as bench:
        assert bench.loop.guard.limited == 0
        bench.controller.replace_tick = lambda *_: Command(0.1, 1e6, bridge=True)
        bench.frames(3)
        assert bench.loop.guard.limited == 3
        assert bench.loop.command.boost_reference_V == FAST.drive.limits.boost_reference_max_V


async def test_a_frame_that_waited_in_the_bus_takes_the_place_of_the_stand_in(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with fast_bench() as bench:
        bench.frames(5)
        bench.counter += 1
        waiting = replace(bench.measured, arrival_s=bench.around.now + TICK_S,
                          oldest_s=bench.around.now + TICK_S, counter=bench.counter)  # fmt: skip
        monkeypatch.setattr(bench.port, "catch_up", lambda: bench.port.deliver(waiting))
        deadline_s = bench.around.now = bench.around.deadline_s
        bench.loop.on_deadline(deadline_s)
        assert [report.measurement.fresh for report in bench.reports] == [True] * 6
        assert bench.ticks == list(range(6))
        assert bench.loop.held == 0


async def test_a_drive_frozen_while_it_is_off_is_told_to_be_safe_and_does_not_trip() -> None:
    async with fast_bench() as bench:
        bench.frames(5)
        bench.stand_still_in_ticks(0.5)
        known = len(bench.sent)
        bench.frame()
        assert bench.machine.trip is None
        assert bench.sent[known:] == [SAFE_COMMAND]
