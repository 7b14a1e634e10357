"""A drive that is polled: one tick for each poll, on a grid of whole polls."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from dataclasses import replace
from itertools import pairwise

import pytest

from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable
from adaptdrive.runtime.settings import FastLoopSettings
from tests.unit.runtime.bench import FAST, TICK_S, FastBench, decision, fast_bench

STRIDE = 12
POLL_S = STRIDE * TICK_S
POLLED = replace(
    FAST,
    drive_clocks=False,
    timing=replace(FAST.timing, stale_s=2.5 * POLL_S, ticks_per_reading=STRIDE),
    latency_ticks=STRIDE,
)


def poll(bench: FastBench, after_s: float = POLL_S, **changes: object) -> None:
    bench.frame(after_s, 1, counter=None, **changes)


def polls(bench: FastBench, count: int, after_s: float = POLL_S) -> None:
    for _ in range(count):
        poll(bench, after_s)


@contextlib.asynccontextmanager
async def enabled(settings: FastLoopSettings = POLLED, count: int = 3) -> AsyncIterator[FastBench]:
    """A bench whose drive was enabled and polled so many times since."""
    poll_s = settings.timing.ticks_per_reading * TICK_S
    async with fast_bench(settings, modulus=None) as bench:
        polls(bench, 3, poll_s)
        bench.ask(Enable())
        polls(bench, count, poll_s)
        yield bench


@pytest.mark.parametrize(
    ("stride", "stale_s", "frozen_s"), [(6, 0.25, 0.18), (12, 2.0, 1.2)], ids=["short", "long"]
)
async def test_a_drive_that_stopped_while_nothing_ran_is_not_energised_when_the_timer_is_first(
    stride: int, stale_s: float, frozen_s: float
) -> None:
    """The stand-in tick judges the reading of before the freeze, which is not stale yet."""
    settings = replace(
        POLLED,
        latency_ticks=stride,
        timing=replace(FAST.timing, stale_s=stale_s, ticks_per_reading=stride),
    )
    poll_s = stride * TICK_S
    async with enabled(settings, 8) as bench:
        assert bench.state() is State.RUNNING
        deadline_s = bench.around.deadline_s
        bench.around.now += frozen_s
        bench.loop.on_deadline(deadline_s)
        assert bench.state() is State.RUNNING
        stopped = replace(bench.measured, counter=None, bridge=False)
        for number in range(2):
            bench.around.now += 0.001 + number * poll_s
            now_s = bench.around.now
            bench.port.deliver(replace(stopped, arrival_s=now_s, oldest_s=now_s))
        assert bench.trip.startswith("drive stopped: ")
        assert "; the daemon had not run for " in bench.trip
        assert bench.sent[-1] == SAFE_COMMAND


async def test_nothing_energises_before_a_drive_has_reported_after_a_freeze() -> None:
    """The reply of before the freeze makes a tick of its own; only the next poll is a report."""
    settings = replace(POLLED, timing=replace(POLLED.timing, stale_s=2.0))
    async with enabled(settings, 8) as bench:
        known = len(bench.sent)
        deadline_s, asked_s = bench.around.deadline_s, bench.around.now
        bench.around.now += 1.2
        bench.loop.on_deadline(deadline_s)
        poll(bench, 0.001, oldest_s=asked_s, bridge=True)
        assert bench.sent[known:] == []
        poll(bench, bridge=False)
        assert bench.trip.startswith("drive stopped: ")
        assert set(bench.sent[known:]) == {SAFE_COMMAND}


async def test_each_poll_makes_one_tick_and_one_command() -> None:
    """One without a reading is stood in for, and then caught up with."""
    async with fast_bench(POLLED, modulus=None) as bench:
        polls(bench, 30)
        assert bench.ticks == [STRIDE * number for number in range(30)]
        assert len(bench.sent) == 30
        assert all(report.measurement.fresh for report in bench.reports)
        poll(bench, 2 * POLL_S)
        assert [report.measurement.fresh for report in bench.reports[30:]] == [False, True]
        assert [b - a for a, b in pairwise(bench.ticks)] == [STRIDE] * 31
        assert (bench.loop.missed, bench.loop.held) == (0, 1)


async def test_a_decision_takes_effect_at_its_poll_until_the_slow_loop_trips_in_one() -> None:
    async with enabled() as bench:
        known = len(bench.around.snapshots)
        while len(bench.around.snapshots) == known:
            poll(bench)
        taken = bench.around.snapshots[-1]
        bench.loop.deliver(taken, decision(taken.k, 301.0))
        poll(bench)
        assert bench.reports[-1].applied_k == taken.k
        assert bench.sent[-1].boost_reference_V == 301.0
        assert bench.loop._schedule.late_decisions == 0
        bench.around.room = False
        while bench.state() is State.RUNNING:
            assert bench.sent[-1].bridge
            poll(bench)
        assert bench.trip.startswith("slow loop: ")
        assert bench.sent[-1] == bench.loop.command == SAFE_COMMAND
