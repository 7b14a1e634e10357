"""A stop is what the drive confirms: until then `stopping`, and an alarm when it takes too long."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from dataclasses import replace

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command, Measurement, Order, Stage
from adaptdrive.runtime.reports import State, StopWord
from adaptdrive.runtime.requests import Disable, Enable, Reset, SetSetpoint
from adaptdrive.safety.stop import Stop, StopWatch
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import TripKind
from adaptdrive.util.errors import RefusedError
from tests.unit.runtime.bench import (
    CALM,
    FAST,
    RATE_FRAMES,
    TICK_S,
    FastBench,
    fast_bench,
    idle_daemon,
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
    assert (running.state(), running.loop.stopping.status) == (State.STOPPING, StopWord.AWAITED)
    running.frame(bridge=True)
    assert running.state() is State.STOPPING
    running.frame(bridge=False)
    assert (running.state(), running.loop.stopping.status) == (State.STANDBY, StopWord.CONFIRMED)


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
            assert (bench.state(), bench.loop.stopping.status) == (State.STOPPING, StopWord.AWAITED)
        bench.frame(bridge=False)
        assert (bench.state(), bench.loop.stopping.status) == (State.STANDBY, StopWord.CONFIRMED)


async def test_a_bridge_that_stays_on_is_an_alarm(running: FastBench) -> None:
    disable(running)
    known = len(running.sent)
    running.frames(STOP_TICKS - 1, bridge=True)
    assert running.state() is State.STOPPING
    with pytest.raises(RefusedError, match="has not confirmed its stop"):
        running.ask(Enable())
    running.frames(3, bridge=True)
    assert (running.state(), running.loop.stopping.status) == (State.TRIPPED, StopWord.MISSING)
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
    assert running.loop.stopping.status is StopWord.CONFIRMED
    running.wait(3 * TICK_S)
    assert (running.state(), running.loop.stopping.status) == (State.STANDBY, StopWord.AWAITED)
    running.frame(bridge=False)
    assert running.loop.stopping.status is StopWord.CONFIRMED


async def test_a_stop_that_no_bus_takes_is_an_alarm(
    running: FastBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running.port, "send", lambda _: False)
    disable(running)
    running.frames(STOP_TICKS + 2, bridge=False)
    assert running.trip.startswith("the drive does not stop: it has not taken the safe command 5")


async def test_a_trip_that_does_not_stop_the_drive_keeps_its_cause(running: FastBench) -> None:
    running.frames(STOP_TICKS + 4, bridge=True, fault=4)
    assert str(running.machine.trip) == "drive fault: word 0x4"
    (alarm,) = running.around.not_stops
    assert alarm.text.startswith("the drive does not stop: its bridge is still on")
    running.frame(bridge=True)
    with pytest.raises(RefusedError, match="bridge is on"):
        running.ask(Reset())


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
        assert bench.loop.stopping.status is StopWord.MISSING


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
        assert (bench.state(), bench.loop.stopping.status) == (State.STANDBY, StopWord.CONFIRMED)
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
        words.add(bench.loop.stopping.status)
    return words


@pytest.mark.parametrize("frames", [STOP_TICKS + 1, 2000])
async def test_a_bridge_that_chatters_after_a_trip_is_one_alarm(
    running: FastBench, frames: int
) -> None:
    running.frame(fault=4)
    running.frames(STOP_TICKS)
    alarms = running.around.not_stops
    for number in (1, 2):
        assert running.loop.stopping.status is StopWord.CONFIRMED
        chatter(running, 3)
        assert chatter(running, frames) == {StopWord.MISSING}
        assert len(alarms) == number
        assert "although this daemon did not command it" in alarms[-1].text
        words = set()
        for _ in range(STOP_TICKS - 1):
            running.frame(bridge=False)
            words.add(running.loop.stopping.status)
        assert words == {StopWord.MISSING}
        running.frames(3)
    assert str(running.machine.trip) == "drive fault: word 0x4"


async def test_a_drive_whose_last_word_is_that_its_bridge_is_on_is_no_stopped_one() -> None:
    async with fast_bench() as bench:
        bench.frames(20)
        bench.frame(bridge=True)
        bench.wait(FAST.timing.stop_s + 10 * TICK_S)
        assert (bench.state(), bench.loop.stopping.status) == (State.TRIPPED, StopWord.MISSING)


@pytest.mark.parametrize("stays", [False, True])
async def test_a_drive_found_on_at_start_must_stop(*, stays: bool) -> None:
    async with fast_bench() as bench:
        bench.wait(10.0)
        assert bench.state() is State.STANDBY
        assert bench.loop.stopping.status is StopWord.AWAITED
        for _ in range(STOP_TICKS - 2):
            bench.frame(bridge=True)
            assert bench.state() is State.STOPPING
        bench.frames(5, bridge=stays)
        assert bench.state() is (State.TRIPPED if stays else State.STANDBY)
        assert bench.trip.startswith("the drive does not stop: its bridge is " if stays else "")


@pytest.mark.parametrize("overslept_s", [0.0, 0.02, 0.5])
async def test_a_stop_that_is_not_confirmed_is_an_alarm_however_long_the_last_sleep_is(
    overslept_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running_bench() as bench:
        around = bench.around
        daemon = idle_daemon(bench.machine, bench.loop, around.now_s)
        bench.ask(Disable())
        limit_s = around.now + bench.loop.stop_limit_s

        async def sleep(seconds: float) -> None:
            late = around.now + 2.0 * seconds > limit_s
            around.now += seconds + (overslept_s if late else 0.0)

        monkeypatch.setattr(asyncio, "sleep", sleep)
        await daemon._await_stop()
        monkeypatch.undo()
        assert bench.trip.startswith("the drive does not stop")


READING_S = 2.0**-7
STOP_S = 64.0
TIMING = Timing(READING_S, stale_s=0.05, start_s=0.25, stop_s=0.5)
LATE_S = 0.5 + READING_S
WORDS = {
    "-": Stop.AWAITED,
    "ok": Stop.CONFIRMED,
    "late": Stop.OVERDUE,
    "denied": Stop.DENIED,
}
ON_OFF = [(1.0, False, "ok"), (1.5, True, "ok")]
"""A confirmed stop, and a flicker."""


def judged(watch: StopWatch, after_s: float, *, bridge: bool, safe_s: float = -math.inf) -> Stop:
    """What is known so long after the stop, by a reading of that moment."""
    now_s = STOP_S + after_s
    reading = replace(CALM, arrival_s=now_s, oldest_s=now_s, bridge=bridge)
    return watch.judge(reading, safe_s, now_s)


def stopped(slack_s: float | None = 0.0) -> StopWatch:
    watch = StopWatch(TIMING, slack_s)
    watch.command(STOP_S)
    return watch


@pytest.mark.parametrize(
    ("slack_s", "readings"),
    [
        (0.0, [(0.5, True, "-"), (LATE_S, True, "late")]),
        (0.25, [(0.75, True, "-"), (0.25 + LATE_S, True, "late")]),  # a report that comes later
        (0.0, [*ON_OFF, (2.0, False, "ok"), (2.5, True, "ok"), (3.0, False, "ok")]),  # flickers
        (0.0, [*ON_OFF, (1.5, True, "ok"), (2.0, True, "denied"), (2.25, True, "-"),
               (2.5, True, "-"), (2.75, True, "late"), (4.0, False, "ok")]),
        (0.0, [(0.125, False, "ok"), (0.25, True, "ok"), (0.375, True, "denied")]),
        (0.0, [(0.0, False, "-"), (0.25, True, "-"), (0.375, True, "-")]),  # from before the stop
    ],
)  # fmt: skip
def test_a_stop_is_what_the_drive_reports_after_it(
    slack_s: float, readings: list[tuple[float, bool, str]]
) -> None:
    watch = stopped(slack_s)
    found = [judged(watch, after_s, bridge=bridge) for after_s, bridge, _ in readings]
    assert found == [WORDS[word] for _, _, word in readings]


def test_a_drive_without_a_word_has_stopped_when_it_has_taken_the_command() -> None:
    watch = stopped(None)
    assert judged(watch, 0.1, bridge=True, safe_s=math.inf) is Stop.AWAITED
    assert judged(watch, 0.2, bridge=True, safe_s=STOP_S) is Stop.CONFIRMED


def test_a_drive_that_was_energised_confirms_its_next_stop_anew() -> None:
    watch = stopped()
    for after_s, bridge, _ in ON_OFF:
        judged(watch, after_s, bridge=bridge)
    watch.release()
    watch.command(STOP_S + 2.0)
    assert judged(watch, 2.25, bridge=True) is Stop.AWAITED
    assert judged(watch, 2.5, bridge=False) is Stop.CONFIRMED
    assert judged(watch, 3.0, bridge=True) is Stop.CONFIRMED
    assert judged(watch, 3.5, bridge=True) is Stop.DENIED


@pytest.mark.parametrize(("reading_s", "due_s"), [(1 / 120, 0.25), (0.2, 0.25), (1.0, 1.0)])
def test_a_drive_that_is_read_seldom_has_one_reading_to_obey(
    reading_s: float, due_s: float
) -> None:
    watch = StopWatch(Timing(reading_s, 0.05, start_s=0.25, stop_s=0.5), 0.0)
    watch.release(CALM, bridge=True)
    watch.command(STOP_S)
    assert judged(watch, due_s - 0.01, bridge=False) is Stop.AWAITED
    assert judged(watch, due_s + 0.01, bridge=False) is Stop.CONFIRMED


@pytest.mark.parametrize(("been_on", "confirmed"), [(False, False), (True, True)])
def test_a_bridge_that_has_been_on_and_went_off_by_itself_is_off_at_once(
    *, been_on: bool, confirmed: bool
) -> None:
    """Nothing of a command that it has obeyed already is under way."""
    watch = StopWatch(TIMING, 0.0)
    for on in (been_on, False):
        watch.release(replace(CALM, bridge=on), bridge=True)
    watch.command(STOP_S)
    assert (judged(watch, 0.125, bridge=False) is Stop.CONFIRMED) is confirmed


def test_the_reason_names_the_time_since_the_stop() -> None:
    why = stopped().unconfirmed(None, math.inf, STOP_S + 2.0)
    assert why.kind is TripKind.STOP_NOT_TAKEN
    assert ": it has not taken the safe command 2000 ms after the stop; " in why.text


async def test_the_word_of_the_stop_before_is_void_in_the_tick_of_a_trip(
    running: FastBench,
) -> None:
    words = []
    for bridge in (True, True, False):
        running.frame(bridge=bridge, fault=4)
        assert running.state() is State.TRIPPED
        words.append(running.loop.stopping.status)
    assert words == [StopWord.AWAITED, StopWord.AWAITED, StopWord.CONFIRMED]


async def test_a_reset_before_a_denied_stop_is_confirmed_awaits_it_for_the_time_of_a_stop() -> None:
    async with fast_bench() as bench:
        bench.frames(20)
        said_s = bench.around.now
        chatter(bench, 3)
        bench.frames(2, bridge=False, bridge_s=said_s)
        bench.frame(bridge=True)
        bench.frame(bridge=False, bridge_s=said_s)
        bench.ask(Reset())
        bench.frames(STOP_TICKS + 2, bridge=True)
        assert bench.trip.startswith("the drive does not stop: its bridge is still")
