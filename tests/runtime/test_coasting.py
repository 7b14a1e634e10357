"""A drive that coasts: enabled, commanded off, and confirmed off, until a set-point starts it."""

from __future__ import annotations

import pytest

from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.runtime.reports import State, StopWord
from adaptdrive.runtime.requests import Disable, Enable, SetSetpoint
from tests.runtime.bench import FAST, RATE_FRAMES, TICK_S, FastBench, fast_bench, running_bench

LONG_FRAMES = round(2.0 * FAST.timing.stop_s / TICK_S)


def enable_at_rest(bench: FastBench) -> None:
    """Enable a drive whose load stands still."""
    bench.frames(RATE_FRAMES)
    bench.frames(3, output=0.0)
    bench.ask(Enable())


async def test_enabling_a_load_at_rest_sends_safe_commands_alone_and_trips_nothing() -> None:
    async with fast_bench() as bench:
        enable_at_rest(bench)
        bench.frames(LONG_FRAMES, output=0.0)
        assert set(bench.sent) == {SAFE_COMMAND}
        assert (bench.state(), bench.machine.trip) == (State.RUNNING, None)
        assert bench.loop.stop is StopWord.CONFIRMED


async def test_a_set_point_starts_it_through_the_precharge() -> None:
    async with fast_bench() as bench:
        enable_at_rest(bench)
        bench.frame(output=0.0)
        bench.sent.clear()
        bench.ask(SetSetpoint(3.0))
        bench.frames(4)
        assert [command.bridge for command in bench.sent] == [False, True, True, True]
        assert bench.machine.trip is None


async def test_coasting_from_a_run_must_be_confirmed_by_the_drive() -> None:
    async with running_bench() as bench:
        bench.ask(SetSetpoint(0.0))
        bench.frames(LONG_FRAMES)
        assert bench.sent[-1] == SAFE_COMMAND
        assert (bench.machine.trip, bench.loop.stop) == (None, StopWord.CONFIRMED)
        bench.ask(SetSetpoint(3.0))
        bench.frames(LONG_FRAMES)
        assert bench.state() is State.RUNNING
        assert bench.sent[-1].bridge


async def test_a_bridge_that_stays_on_while_it_should_coast_trips() -> None:
    async with running_bench() as bench:
        bench.ask(SetSetpoint(0.0))
        bench.frames(LONG_FRAMES, bridge=True)
        assert bench.trip.startswith("the drive does not stop: its bridge is still")


async def test_a_bridge_that_comes_on_while_it_coasts_trips() -> None:
    async with fast_bench() as bench:
        enable_at_rest(bench)
        bench.frames(10)
        bench.frames(3, bridge=True)
        assert "although this daemon did not command it" in bench.trip


async def test_a_drive_that_cannot_confirm_coasts_as_well() -> None:
    async with running_bench(slack_s=None) as bench:
        bench.ask(SetSetpoint(0.0))
        bench.frames(LONG_FRAMES)
        assert bench.machine.trip is None
        assert bench.loop.stop is StopWord.IMPOSSIBLE


@pytest.mark.parametrize("output", [0.0, 1.5])
async def test_an_output_that_stands_or_falls_while_it_coasts_is_believed(output: float) -> None:
    async with running_bench() as bench:
        bench.ask(SetSetpoint(0.0))
        bench.frames(1000, output=output)
        assert bench.machine.trip is None
        bench.ask(Disable())
        bench.frames(3)
        assert bench.state() is State.STANDBY
