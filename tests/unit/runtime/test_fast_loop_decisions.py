"""Requests and decisions reach the controller at their tick; a drive coasts until a set-point."""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Mode, Shape, Stage, Waveform
from adaptdrive.runtime.reports import State, StopWord
from adaptdrive.runtime.requests import (
    Disable,
    Enable,
    Request,
    Reset,
    SetMode,
    SetPole,
    SetSetpoint,
    SetWaveform,
)
from tests.support import a_trip
from tests.unit.runtime.bench import (
    FAST,
    LATENCY,
    RATE_FRAMES,
    TICK_S,
    FastBench,
    Q,
    decision,
    fast_bench,
    running_bench,
)


def applied(bench: FastBench) -> dict[int, int]:
    """Ticks at which decisions took effect, and which."""
    return {
        report.measurement.tick: report.applied_k
        for report in bench.reports
        if report.applied_k >= 0
    }


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


async def test_a_slow_loop_that_has_fallen_hopelessly_behind_trips() -> None:
    async with running_bench() as bench:
        bench.around.room = False
        bench.run_to_snapshot()
        bench.frame()
        assert bench.trip.startswith("slow loop: ")
        assert bench.sent[-1] == SAFE_COMMAND


@pytest.mark.parametrize("delivered_after", [0, 1])
async def test_a_decision_takes_effect_at_its_fixed_tick(delivered_after: int) -> None:
    """Be it a stand-in."""
    async with running_bench() as bench:
        taken = bench.run_to_snapshot()
        bench.frames(delivered_after)
        made = decision(taken.k, 333.0)
        bench.loop.deliver(taken, made)
        bench.wait(5.0 * TICK_S)
        assert applied(bench) == {taken.tick + LATENCY: taken.k}
        references = {one.measurement.tick: one.command.boost_reference_V for one in bench.reports}
        in_force = [tick for tick, reference_V in references.items() if reference_V == 333.0]
        assert in_force[0] == taken.tick + LATENCY
        assert bench.loop._schedule.late_decisions == 0
        assert bench.around.decisions == [made]


async def test_a_late_decision_takes_effect_at_the_next_tick_and_is_flagged() -> None:
    async with running_bench() as bench:
        taken = bench.run_to_snapshot()
        bench.frames(7)
        bench.loop.deliver(taken, decision(taken.k, 333.0))
        bench.frames(5)
        assert applied(bench) == {taken.tick + 8: taken.k}
        assert bench.loop._schedule.late_decisions == 1


@pytest.mark.parametrize("delivered", ["before", "after", "in the next run"])
@pytest.mark.parametrize("trips", [False, True])
async def test_a_decision_of_a_run_that_has_ended_is_dropped(
    delivered: str, *, trips: bool
) -> None:
    async with running_bench() as bench:
        taken = bench.run_to_snapshot()
        made = decision(taken.k, 333.0)
        if delivered == "before":
            bench.loop.deliver(taken, made)
        if trips:
            bench.machine.latch(a_trip("a test"))
        bench.ask(Disable())
        if delivered == "after":
            bench.loop.deliver(taken, made)
        bench.frames(2)
        assert set(bench.sent[-2:]) == {SAFE_COMMAND}
        bench.ask(Reset())
        bench.start()
        if delivered == "in the next run":
            bench.loop.deliver(taken, made)
        bench.frames(10)
        assert applied(bench) == {}
        assert bench.around.decisions == [made] * (delivered == "before")


CHANGES: dict[str, tuple[Request, dict[str, object]]] = {
    "reference": (SetSetpoint(2.5), {"reference": 2.5}),
    "mode": (SetMode(Mode.ADAPTIVE), {"mode": Mode.ADAPTIVE}),
    "pole": (SetPole(0.8), {"pole": 0.8}),
    "steady": (
        SetWaveform(Waveform(Shape.SQUARE, 2.5, 3.0, 60.0), preview=False),
        {"steady": False},
    ),
}


@pytest.mark.parametrize("name", CHANGES)
async def test_one_change_reaches_the_next_tick_and_nothing_else_does(name: str) -> None:
    request, expected = CHANGES[name]
    async with running_bench() as bench:
        bench.ask(SetSetpoint(3.0))  # where the waveform begins
        bench.frames(2)
        before = bench.reports[-1].order
        assert bench.reports[-2].order is before
        bench.ask(request)
        bench.frame()
        assert bench.reports[-1].order == replace(before, **expected)  # type: ignore[arg-type]


LONG_FRAMES = round(2.0 * FAST.timing.stop_s / TICK_S)


async def test_coasting_from_a_run_must_be_confirmed_by_the_drive() -> None:
    async with running_bench() as bench:
        bench.ask(SetSetpoint(0.0))
        bench.frames(LONG_FRAMES)
        assert bench.sent[-1] == SAFE_COMMAND
        assert (bench.machine.trip, bench.loop.stopping.status) == (None, StopWord.CONFIRMED)
        bench.ask(SetSetpoint(3.0))
        bench.frames(LONG_FRAMES)
        assert bench.state() is State.RUNNING
        assert bench.sent[-1].bridge


async def test_enabled_at_rest_it_coasts_until_a_set_point_starts_it() -> None:
    async with fast_bench() as bench:
        bench.frames(RATE_FRAMES, output=0.0)
        bench.ask(Enable())
        bench.frames(LONG_FRAMES, output=0.0)
        assert set(bench.sent) == {SAFE_COMMAND}
        assert (bench.state(), bench.machine.trip) == (State.RUNNING, None)
        assert bench.loop.stopping.status is StopWord.CONFIRMED
        bench.sent.clear()
        bench.ask(SetSetpoint(3.0))
        bench.frames(4)
        assert [command.bridge for command in bench.sent] == [False, True, True, True]
        assert bench.machine.trip is None


@pytest.mark.parametrize(
    ("stays", "cause"),
    [
        (0, "the drive does not stop: its bridge is still"),
        (9, "the drive's bridge is on although this daemon did not command it"),
    ],
)
async def test_a_bridge_that_is_on_while_it_coasts_trips(stays: int, cause: str) -> None:
    async with running_bench() as bench:
        bench.ask(SetSetpoint(0.0))
        bench.frames(stays)
        bench.frames(LONG_FRAMES, bridge=True)
        assert bench.trip.startswith(cause)
