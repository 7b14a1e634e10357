"""What the fast loop counts, times and shows, against frames that the test counts and times."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.runtime.requests import SetSetpoint
from tests.runtime.bench import FAST, TICK_S, decision, fast_bench, running_bench

STRIDE = 12
POLLED = replace(FAST, timing=replace(FAST.timing, ticks_per_reading=STRIDE), drive_clocks=False)
EXACT_S = 2.0**-7
"""A half cycle whose multiples are exact."""


async def test_before_the_first_tick_the_command_is_safe() -> None:
    async with fast_bench() as bench:
        assert bench.loop.command == SAFE_COMMAND
        bench.frame()
        assert bench.ticks == [0]


async def test_every_tick_counts_once() -> None:
    async with fast_bench() as bench:
        bench.frames(7)
        bench.wait(3.0 * TICK_S)
        counts = bench.loop.counts
        assert (counts.ticks, counts.held, counts.missed) == (len(bench.reports), 2, 0)
        assert len(bench.reports) == 9


@pytest.mark.parametrize("known", [1, 5])
async def test_a_frame_that_was_lost_is_a_missed_half_cycle(known: int) -> None:
    async with fast_bench(replace(FAST, timer_standin=False)) as bench:
        bench.frames(known)
        bench.frame(after_s=3 * TICK_S, steps=3)
        assert bench.ticks == [*range(known), known + 2]
        assert bench.loop.counts.missed == 2


async def test_polls_that_the_machine_overslept_are_missed() -> None:
    async with fast_bench(POLLED, modulus=None) as bench:
        bench.frames(3, after_s=STRIDE * TICK_S, counter=None)
        bench.oversleep(4.5 * STRIDE * TICK_S)
        assert bench.ticks == [0, STRIDE, 2 * STRIDE, 7 * STRIDE]
        assert bench.loop.counts.missed == 4


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


async def test_a_stand_in_has_no_frame_whose_turnaround_could_be_timed() -> None:
    async with fast_bench() as bench:
        bench.frames(5)
        bench.loop.turnaround.take()
        bench.oversleep(0.001)
        report = bench.reports[-1]
        assert report.lateness_us == pytest.approx(1000.0, rel=1e-8)
        assert math.isnan(report.turnaround_us)
        assert math.isnan(bench.loop.turnaround.take().max)


async def test_a_tick_half_a_period_late_feeds_no_watchdog() -> None:
    async with fast_bench(
        replace(FAST, timing=replace(FAST.timing, half_cycle_s=EXACT_S))
    ) as bench:
        bench.around.now = 1024.0
        bench.frame(after_s=EXACT_S)
        bench.around.fed.clear()
        bench.oversleep(0.5 * EXACT_S)
        assert bench.around.fed == []


async def test_a_command_that_is_held_to_a_limit_is_counted() -> None:
    async with running_bench() as bench:
        assert bench.loop.guard.limited == 0
        bench.controller.replace_tick = lambda *_: Command(0.1, 1e6, bridge=True)
        bench.frames(3)
        assert bench.loop.guard.limited == 3
        assert bench.loop.command.boost_reference_V == FAST.command.boost_reference_max_V


async def test_the_reading_period_is_that_of_the_drive() -> None:
    async with fast_bench() as bench:
        assert bench.loop.reading_period_s == TICK_S
        bench.frames(600, after_s=1.01 * TICK_S)
        assert bench.loop.reading_period_s == pytest.approx(1.01 * TICK_S, rel=1e-6)


async def test_a_decision_that_is_taken_is_announced() -> None:
    async with running_bench() as bench:
        taken = bench.run_to_snapshot()
        made = decision(taken.k, 333.0)
        bench.loop.deliver(taken, made)
        assert bench.around.decisions == [made]


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
        assert bench.loop.counts.held == 0


async def test_a_drive_frozen_while_it_is_off_is_told_to_be_safe_and_does_not_trip() -> None:
    async with fast_bench() as bench:
        bench.frames(5)
        bench.stand_still_in_ticks(0.5)
        known = len(bench.sent)
        bench.frame()
        assert bench.machine.trip is None
        assert bench.sent[known:] == [SAFE_COMMAND]


async def test_a_set_point_that_changes_ends_no_run() -> None:
    async with running_bench() as bench:
        ended = bench.around.runs_ended
        bench.ask(SetSetpoint(3.25))
        bench.frames(2)
        assert bench.around.runs_ended == ended
