"""The fast loop, tick by tick, in a time that stands still unless a test lets it pass."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command, Stage
from adaptdrive.runtime.accounts import drive_report
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable, Reset
from tests.unit.runtime.bench import (
    FAST,
    MOTOR,
    RATE_FRAMES,
    TICK_S,
    fast_bench,
    running_bench,
    timed,
)

STALE_S = FAST.timing.stale_s


async def test_each_frame_makes_exactly_one_tick_and_one_command() -> None:
    """Before the first one, and in standby, every command is safe."""
    async with fast_bench() as bench:
        bench.wait(10.5 * TICK_S)
        assert (len(bench.sent), bench.reports) == (10, [])
        bench.frame()
        sent, first = len(bench.sent), bench.ticks[0]
        bench.frames(50, boost_voltage_V=222.0, line_voltage_V=118.0, load_power_W=7.0, output=1.5)
        assert bench.ticks == list(range(first, first + 51))
        assert len(bench.sent) - sent == 50
        assert [report.sequence for report in bench.reports] == list(range(51))
        assert all(report.measurement.fresh for report in bench.reports)
        measured = bench.reports[-1].measurement
        values = (measured.boost_voltage_V, measured.line_voltage_V, measured.load_power_W)
        assert (*values, measured.output) == (222.0, 118.0, 7.0, 1.5)
        bench.wait(5.0)
        assert set(bench.sent) == {SAFE_COMMAND}


async def test_a_late_frame_replaces_the_stand_in_and_makes_no_second_tick() -> None:
    async with fast_bench() as bench:
        bench.frames(5)
        bench.measured = replace(bench.measured, output=2.4)
        bench.frame(after_s=1.7 * TICK_S)
        stand_in = bench.reports[-1].measurement
        assert (stand_in.fresh, stand_in.output) == (False, 2.3)
        assert bench.loop.reading is not None
        assert bench.loop.reading.output == 2.4
        bench.frame(after_s=0.3 * TICK_S)
        assert bench.ticks == list(range(bench.ticks[0], bench.ticks[0] + 7))
        assert bench.reports[-1].measurement.fresh
        assert (bench.loop.held, bench.loop.missed) == (1, 0)


async def test_a_value_that_is_held_is_no_new_measurement() -> None:
    """The drive sends one that must not be used: its bridge and its faults count, at once."""
    async with running_bench() as bench:
        bench.frame(whole=False)
        assert not bench.reports[-1].measurement.fresh
        assert bench.sent[-1].bridge
        bench.frame()
        assert bench.reports[-1].measurement.fresh
        bench.frame(whole=False, fault=8)
        assert bench.machine.state is State.TRIPPED


async def test_a_fault_that_one_late_frame_alone_shows_trips() -> None:
    async with running_bench() as bench:
        bench.frame(after_s=1.7 * TICK_S, fault=8)
        bench.frame(after_s=0.3 * TICK_S)
        assert bench.state() is State.TRIPPED
        assert str(bench.machine.trip) == "drive fault: word 0x8"
        assert bench.sent[-1] == SAFE_COMMAND


async def test_a_stop_of_the_drive_that_one_late_frame_alone_shows_trips() -> None:
    """The stand-in before it has switched the drive on again."""
    async with running_bench(frames=40) as bench:
        bench.frame(after_s=1.7 * TICK_S, bridge=False)
        assert bench.trip.startswith("drive stopped: ")
        assert bench.sent[-1] == SAFE_COMMAND


async def test_the_timer_stands_in_on_the_drives_grid() -> None:
    async with fast_bench() as bench:
        bench.frames(5)
        bench.wait(3.1 * TICK_S)
        held = [report.measurement for report in bench.reports if not report.measurement.fresh]
        assert [measured.tick - bench.ticks[4] for measured in held] == [1, 2]
        bench.wait(1000 * TICK_S)
        assert bench.ticks[-1] - bench.ticks[4] == 1002


async def test_ticks_that_the_machine_overslept_are_missed_not_repeated() -> None:
    async with fast_bench() as bench:
        bench.frames(5)
        before, deadline_s = bench.loop.tick, bench.around.deadline_s
        bench.oversleep(5.4 * TICK_S)
        assert bench.loop.tick == before + 6
        assert bench.loop.missed == 5
        assert bench.around.deadline_s == pytest.approx(deadline_s + 6 * TICK_S)


async def test_enabled_it_precharges_with_the_bridge_off_and_then_runs() -> None:
    async with fast_bench() as bench:
        bench.measured = replace(bench.measured, boost_voltage_V=171.0)
        bench.frames(RATE_FRAMES)
        bench.ask(Enable())
        bench.frames(20)
        assert bench.state() is State.STARTING
        assert not any(command.bridge for command in bench.sent)
        assert bench.sent[-1].current_scale_S > 0.0
        bench.measured = replace(bench.measured, boost_voltage_V=201.0)
        bench.frames(2)
        assert bench.state() is State.RUNNING
        assert bench.sent[-1].bridge
        stages = [report.order.stage for report in bench.reports]
        assert sorted(set(stages), key=stages.index) == [Stage.OFF, Stage.PRECHARGE, Stage.RUN]


async def test_a_drive_that_reports_no_voltage_has_the_one_that_it_was_last_commanded() -> None:
    absent = replace(FAST.limits, absent=frozenset({"boost_voltage_V"}))
    async with fast_bench(replace(FAST, limits=absent)) as bench:
        bench.measured = replace(bench.measured, boost_voltage_V=math.nan)
        bench.frames(RATE_FRAMES)
        assert bench.reports[-1].measurement.boost_voltage_V == 0.0
        bench.ask(Enable())
        bench.frames(20)
        assert bench.state() is State.RUNNING
        commanded = bench.sent[-2].boost_reference_V
        assert commanded >= MOTOR.drive.limits.boost_reference_min_V
        assert bench.reports[-1].measurement.boost_voltage_V == commanded


async def test_silence_trips_within_the_limit_and_one_half_cycle() -> None:
    async with running_bench() as bench:
        last_s = bench.around.now
        while bench.state() is State.RUNNING:
            bench.wait(0.1 * TICK_S)
        assert STALE_S < bench.around.now - last_s <= STALE_S + 1.1 * TICK_S
        assert bench.trip.startswith("stale: ")
        assert bench.sent[-1] == SAFE_COMMAND
        assert bench.reports[-1].command == SAFE_COMMAND


async def test_one_value_that_grows_old_trips_though_frames_come() -> None:
    async with running_bench() as bench:
        oldest_s = bench.around.now
        bench.frames(8, oldest_s=oldest_s)
        assert bench.trip.startswith("stale: ")


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"output": math.nan}, "invalid: output = nan is not"),
        ({"fault": 4}, "drive fault: word 0x4"),
        ({"boost_voltage_V": 440.0}, "over-voltage"),
        ({"output": 5.5}, "output above its limit"),
    ],
)
async def test_an_interlock_trips_in_the_tick_that_sees_it(
    changes: dict[str, Any], cause: str
) -> None:
    async with running_bench() as bench:
        bench.frame(**changes)
        assert bench.trip.startswith(cause)
        assert bench.sent[-1] == SAFE_COMMAND
        bench.frames(300)
        assert bench.state() is State.TRIPPED
        assert set(bench.sent[-300:]) == {SAFE_COMMAND}


async def test_a_bridge_that_goes_off_by_itself_trips() -> None:
    async with running_bench(frames=40) as bench:
        bench.frame(bridge=False)
        assert bench.trip.startswith("drive stopped")
        assert bench.sent[-1] == SAFE_COMMAND


@pytest.mark.parametrize("late", [25, 60])
async def test_a_bridge_that_does_not_come_on_trips(late: int) -> None:
    """One that takes its time does not."""
    async with fast_bench() as bench:
        bench.frames(RATE_FRAMES)
        bench.ask(Enable())
        bench.frames(4 + late, bridge=False)
        assert bench.trip.startswith("drive stopped" if late > 25 else "")
        bench.frames(100)
        assert (bench.state() is State.RUNNING) is (late == 25)


async def test_a_bridge_that_bounces_while_it_switches_on_gets_no_command_until_it_is_on() -> None:
    async with running_bench(frames=2) as bench:
        before = len(bench.sent)
        bench.frame(bridge=False)
        assert len(bench.sent) == before
        bench.frames(2)
        assert bench.state() is State.RUNNING
        assert len(bench.sent) == before + 2


@pytest.mark.parametrize("silent_s", [0.02, 0.045, 0.075])
async def test_a_drive_that_started_anew_and_came_on_before_its_first_report_is_not_driven_on(
    silent_s: float,
) -> None:
    """The commands of a silence too short to be one have switched it on again."""
    async with running_bench(timed(stale_s=0.3), modulus=256, frames=10) as bench:
        bench.wait(silent_s)
        known, bench.counter = len(bench.sent), -1
        for number in range(30):
            bench.frame(TICK_S if number else 0.0, bridge=number < 10)
        assert bench.trip.startswith("drive restarted: its half-cycle counter ")
        assert set(bench.sent[known:]) == {SAFE_COMMAND}
        bench.ask(Reset())
        bench.ask(Enable())
        bench.frames(100)
        assert bench.state() is State.RUNNING


@pytest.mark.parametrize(
    ("timeout_s", "earliest_s", "latest_s"), [(None, 0.05, 0.1), (0.05, 0.02, 0.05)]
)
@pytest.mark.parametrize("silent_s", [0.2, 0.35])
async def test_a_drive_that_stopped_while_it_was_silent_is_not_driven_on(
    silent_s: float, timeout_s: float | None, earliest_s: float, latest_s: float
) -> None:
    """Its cable was out for longer than its own time-out, and shorter than `stale_s`."""
    timing = replace(FAST.timing, stale_s=0.5)
    async with fast_bench(
        replace(FAST, timing=replace(timing, command_timeout_s=timeout_s))
    ) as bench:
        bench.start()
        bench.frames(10)
        began_s, last_s = bench.around.now, bench.around.now
        ticks, sent = bench.loop.ticks, len(bench.sent)
        for _ in range(round(silent_s / TICK_S)):
            known = len(bench.sent)
            bench.wait(TICK_S)
            last_s = bench.around.now if len(bench.sent) > known else last_s
        withheld = bench.loop.ticks - ticks - (len(bench.sent) - sent)
        assert withheld > 0
        books = drive_report(bench.loop, bench.port.statistics, (), bench.around.now)
        assert books.bus["withheld_commands"] == withheld
        assert earliest_s < last_s - began_s < latest_s
        known = len(bench.sent)
        bench.frames(10, 0.0, steps=round(silent_s / TICK_S), bridge=False)
        assert "nothing had been heard of it for" in bench.trip
        assert set(bench.sent[known:]) == {SAFE_COMMAND}


@pytest.mark.parametrize("bridge", [True, False])
async def test_a_command_that_waits_is_sent_when_the_drive_reports_that_it_is_still_on(
    bridge: bool,
) -> None:
    """The report comes in the tick that the command waits in, and no other tick may follow soon."""
    async with running_bench(timed(stale_s=0.5), frames=10) as bench:
        bench.wait(0.3)
        tick, known = bench.loop.tick, len(bench.sent)
        bench.frame(0.0, steps=34, bridge=bridge)
        assert bench.loop.tick == tick
        assert bench.machine.energised is bridge
        assert [command.bridge for command in bench.sent[known:]] == [bridge]


@pytest.mark.parametrize(("frozen_s", "trips"), [(0.05, False), (0.2, True)])
async def test_a_command_that_stood_still_on_its_way_to_the_bus_is_followed_by_the_safe_one(
    frozen_s: float, *, trips: bool
) -> None:
    """The drive may have stopped by its own time-out before the command, and be on again by it."""
    async with running_bench(timed(stale_s=0.5), frames=10) as bench:
        known = len(bench.sent)
        bench.stand_still_in_next_command(frozen_s)
        bench.frame()
        assert [command.bridge for command in bench.sent[known:]] == [True, False][: 1 + trips]
        assert bench.machine.energised is not trips
        if trips:
            assert bench.trip.startswith(
                "overslept: the daemon did not run for 200 ms while it sent a command: "
            )


@pytest.mark.parametrize("stopped", [False, True])
@pytest.mark.parametrize(
    ("timeout_s", "frozen_s", "polled", "trips"),
    [
        (1.0, 0.4, False, False),
        (1.0, 0.4, True, False),
        (0.3, 0.3, True, True),
        (None, 0.2, True, True),
        (None, 0.2, False, True),  # it may have stopped just before the command
        (0.3, 0.3, False, True),
        (2.0, 0.6, False, True),  # longer than `stale_s`
    ],
)
async def test_reports_that_waited_show_whether_a_drive_stopped_before_a_late_command(
    timeout_s: float | None, frozen_s: float, *, polled: bool, trips: bool, stopped: bool
) -> None:
    settings = replace(timed(stale_s=0.5, command_timeout_s=timeout_s), drive_clocks=not polled)
    async with running_bench(settings, frames=10) as bench:
        bench.stand_still_in_next_command(frozen_s)
        bench.frame()
        assert bench.machine.energised is not trips
        assert bench.sent[-1].bridge is not trips
        bench.frame(0.0, steps=round(frozen_s / TICK_S), bridge=not stopped)
        assert bench.machine.energised is not (trips or stopped)
        assert bench.sent[-1].bridge is not (trips or stopped)


async def test_a_report_that_came_late_once_does_not_void_those_that_wait() -> None:
    async with running_bench(timed(stale_s=0.5, command_timeout_s=1.0), frames=10) as bench:
        bench.frame(bridge=True, bridge_s=bench.around.now - 2.0 * TICK_S)
        bench.frame(bridge=True)
        bench.stand_still_in_next_command(0.4)
        bench.frame()
        assert bench.machine.energised


async def test_a_drive_that_stopped_while_another_node_went_on_clocking_is_not_driven_on() -> None:
    """Its own cable was out for longer than its time-out; what clocks the readings still came."""
    async with running_bench(timed(stale_s=0.5), frames=10) as bench:
        heard_s, last_s = bench.around.now, bench.around.now
        for _ in range(36):
            known = len(bench.sent)
            bench.frame(bridge=True, bridge_s=heard_s)
            last_s = bench.around.now if len(bench.sent) > known else last_s
        assert 0.05 < last_s - heard_s < 0.1
        known = len(bench.sent)
        bench.frame(bridge=False)
        assert "nothing had been heard of it for" in bench.trip
        assert set(bench.sent[known:]) == {SAFE_COMMAND}


async def test_a_drive_that_went_on_while_it_was_silent_is_driven_on() -> None:
    async with running_bench(timed(stale_s=0.5), frames=10) as bench:
        bench.wait(0.3)
        known = len(bench.sent)
        bench.frame(0.0, steps=36, bridge=True)
        assert bench.sent[known].bridge
        bench.frames(100)
        assert bench.state() is State.RUNNING


@pytest.mark.parametrize("bridge", [False, True])
@pytest.mark.parametrize("frozen_s", [1.1 * STALE_S, 0.09, 0.5, 10.0])
async def test_a_daemon_frozen_beyond_the_limit_trips(frozen_s: float, bridge: bool) -> None:
    """However fresh the frame, and whatever the drive says of its bridge, if it says anything."""
    async with running_bench(frames=10) as bench:
        known = len(bench.sent)
        bench.thaw(frozen_s, bridge=bridge)
        assert bench.trip.startswith("overslept: the daemon did not run for ")
        assert bench.sent[known:] == [SAFE_COMMAND]


@pytest.mark.parametrize("bridge", [False, True])
async def test_a_drive_that_went_on_in_a_short_pause_is_driven_on(*, bridge: bool) -> None:
    """Within `stale_s`, and within the grace of a drive that takes its time to switch on."""
    async with running_bench(frames=10) as bench:
        known = len(bench.sent)
        bench.thaw(0.9 * STALE_S, bridge=bridge)
        assert (bench.sent[known:] == []) is not bridge  # one report of off may be a bounce
        bench.frame(bridge=bridge)
        assert (bench.state() is State.RUNNING) is bridge
        assert bridge or bench.trip.startswith("drive stopped")
        assert bridge or bench.sent[known:] == [SAFE_COMMAND]


async def test_a_tick_frozen_in_its_command_ends_safe(monkeypatch: pytest.MonkeyPatch) -> None:
    async with running_bench() as bench:
        send = bench.port.send

        def freeze(command: Command) -> bool:
            bench.around.now += 0.0 if command == SAFE_COMMAND else 0.5
            return send(command)

        monkeypatch.setattr(bench.port, "send", freeze)
        bench.frame()
        assert bench.trip.startswith("overslept: ")
        assert bench.sent[-1] == SAFE_COMMAND


@pytest.mark.parametrize("name", ["current_scale_S", "boost_reference_V"])
async def test_a_command_that_is_not_finite_trips(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    async with running_bench() as bench:
        broken = replace(bench.sent[-1], **{name: math.nan})  # type: ignore[arg-type]
        bench.controller.replace_tick = lambda *_: broken
        bench.frame()
        assert bench.state() is State.TRIPPED
        assert bench.trip.startswith("command cannot be sent: the controller gave")
        assert "nan" in bench.trip
        assert bench.sent[-1] == SAFE_COMMAND


async def test_a_command_that_the_wire_cannot_carry_trips_the_drive_not_the_daemon() -> None:
    async with running_bench() as bench:
        bench.unsendable = lambda command: command.bridge
        bench.frame()
        assert bench.trip.startswith("command cannot be sent: k = ")
        assert bench.sent[-1] == SAFE_COMMAND
        bench.frames(10)
        assert set(bench.sent[-10:]) == {SAFE_COMMAND}


async def test_a_restarted_drive_is_followed_again() -> None:
    async with fast_bench() as bench:
        bench.counter = 60_000
        bench.start()
        bench.wait(60.0)
        before = bench.loop.tick
        bench.counter = 0
        bench.frames(100)
        assert bench.loop.tick == pytest.approx(before + 100, abs=2)
        fresh = [report.measurement.fresh for report in bench.reports[-90:]]
        assert all(fresh)
