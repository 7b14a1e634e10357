"""A stop is what the drive confirms: until then `stopping`, and an alarm when it takes too long."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command, Measurement, Order, Stage
from adaptdrive.errors import RefusedError
from adaptdrive.runtime.reports import State, StopWord
from adaptdrive.runtime.requests import Disable, Enable, Reset, SetSetpoint
from adaptdrive.runtime.stop_sender import StopSender
from tests.runtime.bench import (
    FAST,
    RATE_FRAMES,
    TICK_S,
    FastBench,
    fast_bench,
    running_bench,
)

STOP_TICKS = round(FAST.timing.stop_s / TICK_S)


@pytest.fixture
async def running() -> AsyncIterator[FastBench]:
    async with running_bench(frames=5) as bench:
        yield bench


def disable(bench: FastBench) -> None:
    """Disable as the daemon does: the request, then the safe command."""
    bench.ask(Disable())
    bench.loop.send_safe()


async def test_a_stop_is_complete_with_the_drives_word(running: FastBench) -> None:
    disable(running)
    assert (running.state(), running.loop.stop) == (State.STOPPING, StopWord.AWAITED)
    running.frame(bridge=True)
    assert running.state() is State.STOPPING
    running.frame(bridge=False)
    assert (running.state(), running.loop.stop) == (State.STANDBY, StopWord.CONFIRMED)


@pytest.mark.parametrize("ticks_on", [0, 1])
@pytest.mark.parametrize("comes", [[], [1, 1, 1, 0], [1, 0, 1, 1, 0], [0, 1, 0, 0, 1, 1, 1, 1]])
async def test_a_bridge_that_has_yet_to_obey_is_not_off_for_good(
    *, comes: list[int], ticks_on: int
) -> None:
    """A drive that obeys late reports off, then on, and off again; its contact may bounce."""
    async with fast_bench() as bench:
        bench.frames(RATE_FRAMES)
        bench.ask(Enable())
        while not bench.sent[-1].bridge:
            bench.frame(bridge=False)
        bench.frames(ticks_on, bridge=False)
        disable(bench)
        for on in [*[0] * 5, *comes, *[0] * (STOP_TICKS // 2 - 5 - len(comes))]:
            bench.frame(bridge=bool(on))
            assert (bench.state(), bench.loop.stop) == (State.STOPPING, StopWord.AWAITED)
        bench.frame(bridge=False)
        assert (bench.state(), bench.loop.stop) == (State.STANDBY, StopWord.CONFIRMED)


async def test_a_bridge_that_stays_on_is_an_alarm(running: FastBench) -> None:
    disable(running)
    known = len(running.sent)
    running.frames(STOP_TICKS - 1, bridge=True)
    assert running.state() is State.STOPPING
    with pytest.raises(RefusedError, match="has not confirmed its stop"):
        running.ask(Enable())
    running.frames(3, bridge=True)
    assert (running.state(), running.loop.stop) == (State.TRIPPED, StopWord.MISSING)
    assert running.trip.startswith("the drive does not stop: its bridge is still on 5")
    with pytest.raises(RefusedError, match="bridge is on although it is commanded off"):
        running.ask(Reset())
    assert running.sent[known:] == [SAFE_COMMAND] * (STOP_TICKS + 2)
    running.frame(bridge=False)
    running.ask(Reset())
    assert running.state() is State.STANDBY


async def test_a_drive_that_falls_silent_in_its_stop_is_an_alarm(running: FastBench) -> None:
    disable(running)
    running.wait(FAST.timing.stop_s + 3 * TICK_S)
    assert running.trip.startswith("the drive does not stop: it has not reported its bridge off")


async def test_a_drive_that_falls_silent_after_its_stop_confirms_it_no_longer(
    running: FastBench,
) -> None:
    """Somebody may switch it on behind a cable that is out."""
    disable(running)
    running.frame(bridge=False)
    running.wait(FAST.timing.stop_s)
    assert running.loop.stop is StopWord.CONFIRMED
    running.wait(3 * TICK_S)
    assert (running.state(), running.loop.stop) == (State.STANDBY, StopWord.AWAITED)
    running.frame(bridge=False)
    assert running.loop.stop is StopWord.CONFIRMED


async def test_a_stop_that_no_bus_takes_is_an_alarm(
    running: FastBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running.port, "send", lambda _: False)
    disable(running)
    running.frames(STOP_TICKS + 2, bridge=False)
    assert running.trip.startswith("the drive does not stop: it has not taken the safe command 5")


async def test_a_trip_that_does_not_stop_the_drive_keeps_its_cause(running: FastBench) -> None:
    running.frames(STOP_TICKS + 4, bridge=True, fault=4)
    assert running.machine.trip == "drive fault: word 0x4"
    (alarm,) = running.around.not_stops
    assert alarm.startswith("the drive does not stop: its bridge is still on")
    running.frame(bridge=True)
    with pytest.raises(RefusedError, match="bridge is on"):
        running.ask(Reset())


async def test_the_word_of_the_stop_before_is_void_in_the_tick_of_a_trip(
    running: FastBench,
) -> None:
    words = []
    for bridge in (True, True, False):
        running.frame(bridge=bridge, fault=4)
        assert running.state() is State.TRIPPED
        words.append(running.loop.stop)
    assert words == [StopWord.AWAITED, StopWord.AWAITED, StopWord.CONFIRMED]


def precharge(bench: FastBench, *, bridge: bool = False) -> None:
    """Enable a drive whose boost voltage does not rise."""
    bench.measured = replace(bench.measured, boost_voltage_V=170.0)
    bench.frames(RATE_FRAMES)
    bench.ask(Enable())
    bench.frames(4, bridge=bridge)


def precharge_after_coasting(bench: FastBench) -> None:
    """Have a running drive precharge again whose bridge is still on after a set-point of 0."""
    bench.start()
    bench.frames(10)
    bench.measured = replace(bench.measured, boost_voltage_V=170.0)
    bench.ask(SetSetpoint(0.0))
    bench.frame(bridge=True)
    bench.ask(SetSetpoint(3.0))


async def test_a_bridge_switched_on_by_others_in_the_precharge_is_an_alarm() -> None:
    async with fast_bench() as bench:
        precharge(bench)
        bench.frames(10)
        bench.frame(bridge=True)
        assert bench.state() is State.STARTING
        assert not bench.sent[-1].bridge
        bench.frame(bridge=True)
        assert bench.trip.startswith(
            "the drive's bridge is on although this daemon did not command it"
        )
        assert bench.sent[-1] == SAFE_COMMAND
        assert bench.loop.stop is StopWord.MISSING


async def test_a_bridge_that_is_still_on_in_the_precharge_is_a_missing_stop() -> None:
    """It has the time of a stop to open after the drive has coasted."""
    async with fast_bench() as bench:
        precharge_after_coasting(bench)
        began_s = bench.around.now
        while bench.state() is not State.TRIPPED and bench.around.now < began_s + 2.0:
            bench.frame(bridge=True)
        assert bench.trip.startswith("the drive does not stop: its bridge is still on ")
        assert bench.around.now - began_s < FAST.timing.stop_s + 3.0 * TICK_S


async def test_a_drive_whose_enable_bit_is_on_in_the_precharge_may_report_it() -> None:
    async with fast_bench() as bench:
        inner = bench.controller.inner.tick

        def with_bit(measurement: Measurement, order: Order) -> Command:
            command = inner(measurement, order)
            return replace(command, bridge=order.stage is not Stage.OFF)

        bench.controller.replace_tick = with_bit
        precharge(bench)
        bench.frames(100, bridge=True)
        assert bench.state() is State.STARTING


async def test_after_another_source_switched_it_on_a_reset_awaits_the_drives_word() -> None:
    async with fast_bench() as bench:
        bench.frames(20)
        said_s = bench.around.now
        bench.frame(bridge=True)
        bench.wait(4 * TICK_S)  # one reading that is looked at again and again is one flicker
        assert (bench.state(), bench.loop.stop) == (State.STANDBY, StopWord.CONFIRMED)
        bench.frame(bridge=True)
        assert bench.trip.startswith(
            "the drive's bridge is on although this daemon did not command it"
        )
        bench.frame(bridge=False, bridge_s=said_s)
        bench.ask(Reset())
        assert bench.state() is State.STOPPING
        bench.frame(bridge=False)
        assert bench.state() is State.STANDBY


def chatter(bench: FastBench, frames: int) -> set[StopWord]:
    """The words on a bridge that is on in two of three readings, and in the last one."""
    words = set()
    for number in range(frames):
        bench.frame(bridge=(frames - number) % 3 != 0)
        words.add(bench.loop.stop)
    return words


@pytest.mark.parametrize("frames", [STOP_TICKS + 1, 2000])
async def test_a_bridge_that_chatters_after_a_trip_is_one_alarm(
    running: FastBench, frames: int
) -> None:
    running.frame(fault=4)
    running.frames(STOP_TICKS)
    alarms = running.around.not_stops
    for number in (1, 2):
        assert running.loop.stop is StopWord.CONFIRMED
        chatter(running, 3)
        assert chatter(running, frames) == {StopWord.MISSING}
        assert len(alarms) == number
        assert "although this daemon did not command it" in alarms[-1]
        words = set()
        for _ in range(STOP_TICKS - 1):
            running.frame(bridge=False)
            words.add(running.loop.stop)
        assert words == {StopWord.MISSING}
        running.frames(3)
    assert running.machine.trip == "drive fault: word 0x4"


async def test_a_reset_between_two_denied_stops_lets_the_second_one_trip() -> None:
    async with fast_bench() as bench:
        bench.frames(20)
        for _ in range(2):
            chatter(bench, 3)
            assert bench.state() is State.TRIPPED
            bench.frame(bridge=False)
            bench.ask(Reset())
            bench.frame(bridge=False)
            assert (bench.state(), bench.loop.stop) == (State.STANDBY, StopWord.CONFIRMED)


async def test_a_drive_whose_last_word_is_that_its_bridge_is_on_is_no_stopped_one() -> None:
    async with fast_bench() as bench:
        bench.frames(20)
        bench.frame(bridge=True)
        bench.wait(FAST.timing.stop_s + 10 * TICK_S)
        assert (bench.state(), bench.loop.stop) == (State.TRIPPED, StopWord.MISSING)


@pytest.mark.parametrize("stays", [False, True])
async def test_a_drive_found_on_at_start_must_stop(*, stays: bool) -> None:
    async with fast_bench() as bench:
        bench.wait(10.0)
        assert bench.state() is State.STANDBY
        assert bench.loop.stop is StopWord.AWAITED
        for _ in range(STOP_TICKS - 2):
            bench.frame(bridge=True)
            assert bench.state() is State.STOPPING
        bench.frames(5, bridge=stays)
        assert bench.state() is (State.TRIPPED if stays else State.STANDBY)
        assert bench.trip.startswith("the drive does not stop: its bridge is " if stays else "")


async def test_a_drive_that_never_speaks_of_its_bridge_stops_at_once() -> None:
    async with running_bench(slack_s=None) as bench:
        disable(bench)
        assert (bench.state(), bench.loop.stop) == (State.STANDBY, StopWord.IMPOSSIBLE)
        bench.frames(2 * STOP_TICKS)
        assert bench.state() is State.STANDBY


@pytest.mark.parametrize("overslept_s", [0.0, 0.02, 0.5])
async def test_a_stop_that_is_not_confirmed_is_an_alarm_however_long_the_last_sleep_is(
    overslept_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running_bench() as bench:
        around = bench.around
        sender = StopSender(bench.machine, bench.loop, around.now_s)
        bench.ask(Disable())
        limit_s = around.now + bench.loop.stop_limit_s

        async def sleep(seconds: float) -> None:
            late = around.now + 2.0 * seconds > limit_s
            around.now += seconds + (overslept_s if late else 0.0)

        monkeypatch.setattr(asyncio, "sleep", sleep)
        await sender.await_stop()
        monkeypatch.undo()
        assert bench.trip.startswith("the drive does not stop")
