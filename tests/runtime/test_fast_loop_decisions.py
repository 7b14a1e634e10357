"""From a snapshot to the tick at which its decision takes effect."""

from __future__ import annotations

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Mode, Stage
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Disable, Enable, SetMode, SetPole, SetSetpoint
from tests.runtime.bench import LATENCY, FastBench, Q, decision, fast_bench, running_bench


def applied(bench: FastBench) -> dict[int, int]:
    """Ticks at which decisions took effect, and which."""
    return {
        report.measurement.tick: report.applied_k
        for report in bench.reports
        if report.applied_k >= 0
    }


def boost_references(bench: FastBench) -> dict[int, float]:
    return {report.measurement.tick: report.command.boost_reference_V for report in bench.reports}


async def test_snapshots_are_taken_at_multiples_of_the_slow_period() -> None:
    async with fast_bench() as bench:
        bench.counter = 31
        bench.start()
        snapshots = [bench.run_to_snapshot() for _ in range(3)]
        first = snapshots[0].k
        assert [taken.k for taken in snapshots] == [first, first + 1, first + 2]
        assert [taken.tick for taken in snapshots] == [taken.k * Q for taken in snapshots]


async def test_a_snapshot_carries_the_order_of_its_tick() -> None:
    async with running_bench() as bench:
        for request in (SetSetpoint(3.5), SetMode(Mode.ADAPTIVE), SetPole(0.8)):
            bench.ask(request)
        order = bench.run_to_snapshot().order
        assert (order.stage, order.reference) == (Stage.RUN, 3.5)
        assert (order.mode, order.pole) == (Mode.ADAPTIVE, 0.8)


@pytest.mark.parametrize("delivered_after", [0, 1])
async def test_a_decision_takes_effect_at_its_fixed_tick(delivered_after: int) -> None:
    async with running_bench() as bench:
        taken = bench.run_to_snapshot()
        bench.frames(delivered_after)
        bench.loop.deliver(taken, decision(taken.k, 333.0))
        bench.frames(5)
        due = taken.tick + LATENCY
        assert applied(bench) == {due: taken.k}
        references = boost_references(bench)
        assert references[due - 1] != 333.0
        assert all(references[tick] == 333.0 for tick in range(due, due + 3))
        assert bench.loop._schedule.late_decisions == 0


async def test_a_late_decision_takes_effect_at_the_next_tick_and_is_flagged() -> None:
    async with running_bench() as bench:
        taken = bench.run_to_snapshot()
        bench.frames(7)
        bench.loop.deliver(taken, decision(taken.k, 333.0))
        bench.frames(5)
        assert applied(bench) == {taken.tick + 8: taken.k}
        assert bench.loop._schedule.late_decisions == 1


async def test_a_decision_is_applied_on_a_stand_in_tick_too() -> None:
    async with running_bench() as bench:
        taken = bench.run_to_snapshot()
        bench.loop.deliver(taken, decision(taken.k, 333.0))
        bench.wait(0.04)
        assert applied(bench) == {taken.tick + LATENCY: taken.k}


async def test_a_decision_in_flight_across_a_restart_is_dropped() -> None:
    async with running_bench() as bench:
        taken = bench.run_to_snapshot()
        bench.ask(Disable())
        bench.frame()
        bench.start()
        bench.loop.deliver(taken, decision(taken.k, 333.0))
        bench.frames(Q // 2)
        assert applied(bench) == {}
        assert bench.around.decisions == []


async def test_a_decision_that_waits_for_its_tick_is_dropped_by_a_restart() -> None:
    async with running_bench() as bench:
        taken = bench.run_to_snapshot()
        bench.loop.deliver(taken, decision(taken.k, 333.0))
        bench.ask(Disable())
        bench.frames(2)
        bench.ask(Enable())
        bench.frames(10)
        assert bench.state() is State.RUNNING
        assert applied(bench) == {}


@pytest.mark.parametrize("ending", ["disable", "trip"])
async def test_a_decision_after_the_end_of_a_run_is_dropped(ending: str) -> None:
    async with running_bench() as bench:
        taken = bench.run_to_snapshot()
        if ending == "disable":
            bench.ask(Disable())
        else:
            bench.machine.latch("a test")
        bench.loop.deliver(taken, decision(taken.k, 333.0))
        bench.frames(10)
        assert applied(bench) == {}
        assert set(bench.sent[-10:]) == {SAFE_COMMAND}


async def test_a_slow_loop_that_has_fallen_hopelessly_behind_trips() -> None:
    async with running_bench() as bench:
        bench.around.room = False
        bench.run_to_snapshot()
        bench.frame()
        assert bench.trip.startswith("slow loop: ")
        assert bench.sent[-1] == SAFE_COMMAND
