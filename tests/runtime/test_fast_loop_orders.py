"""What the operator asked for reaches the controller in the next tick, each thing by itself."""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Mode
from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import (
    Enable,
    Request,
    SetMode,
    SetPole,
    SetSetpoint,
    SetVoltage,
    SetWaveform,
)
from tests.runtime.bench import FAST, RATE_FRAMES, TICK_S, fast_bench, running_bench

TIMERLESS = replace(FAST, timer_standin=False)
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


async def test_a_voltage_set_by_hand_reaches_the_next_tick() -> None:
    async with running_bench() as bench:
        bench.ask(SetMode(Mode.MANUAL))
        bench.frames(2)
        before = bench.reports[-1].order
        bench.ask(SetVoltage(260.0))
        bench.frames(100)
        assert bench.reports[-1].order == replace(before, manual_V=260.0)


async def test_a_drive_whose_rate_is_unknown_is_not_energised() -> None:
    async with fast_bench() as bench:
        bench.frames(5)
        bench.ask(Enable())
        bench.frames(RATE_FRAMES - 6)
        assert bench.state() is State.STARTING
        assert set(bench.sent) == {SAFE_COMMAND}
        bench.frames(4)
        assert bench.state() is State.RUNNING


async def test_a_drive_at_a_wrong_rate_is_refused() -> None:
    async with fast_bench() as bench:
        bench.frames(3 * RATE_FRAMES, after_s=1.2 * TICK_S)
        assert (bench.loop.cause or "").startswith("frame rate: ")


async def test_a_drive_that_is_polled_has_no_rate_of_its_own() -> None:
    stride = 12
    timing = replace(FAST.timing, stale_s=1.0, ticks_per_reading=stride)
    polled = replace(FAST, timing=timing, drive_clocks=False)
    async with fast_bench(polled, modulus=None) as bench:
        bench.frames(100, after_s=1.3 * stride * TICK_S, counter=None)
        assert bench.loop.cause is None


async def test_silence_without_the_timer_sends_nothing_until_it_trips() -> None:
    async with running_bench(TIMERLESS) as bench:
        known = len(bench.sent)
        bench.wait(0.8 * FAST.timing.stale_s)
        assert len(bench.sent) == known
        bench.wait(10 * TICK_S)
        assert bench.state() is State.TRIPPED
        tripped = len(bench.sent)
        bench.wait(10 * TICK_S)
        assert bench.sent[known:] == [SAFE_COMMAND] * (len(bench.sent) - known)
        assert len(bench.sent) - tripped == 10
