"""One drive as a whole: who is told what, and that it is left safe however it ends."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from itertools import count, pairwise

import pytest

from adaptdrive.app.settings import fast_settings
from adaptdrive.config import Configuration
from adaptdrive.control.signals import SAFE_COMMAND, Command, Decision, Measurement, Mode, Order
from adaptdrive.devices.port import Listener
from adaptdrive.runtime.daemon import Daemon
from adaptdrive.runtime.reports import (
    DriveReport,
    Event,
    Hub,
    LoadReport,
    Report,
    Severity,
    State,
    StateReport,
    StopWord,
)
from adaptdrive.runtime.requests import (
    Disable,
    Enable,
    Reload,
    Reset,
    SetMode,
    SetPole,
    SetSetpoint,
)
from adaptdrive.runtime.tick_support import ServiceManager
from adaptdrive.util.clock import uncaught_errors_end
from adaptdrive.util.errors import BusError, RefusedError
from tests.loopback_port import LoopbackPort
from tests.support import a_trip
from tests.unit.runtime.bench import (
    CALM,
    FAST,
    MACHINE,
    MOTOR,
    LoopTimer,
    MotorController,
    Q,
    until,
)

# Frames are delivered by hand, as fast as they go: neither timer nor age may interfere.
PATIENT = replace(
    fast_settings(MOTOR), drive_clocks=False, timing=replace(FAST.timing, stale_s=1e6)
)


def telling(report_s: float) -> Configuration:
    """The motor, whose daemon reports so often."""
    mqtt = MOTOR.mqtt.model_copy(update={"telemetry_Hz": 1.0 / report_s})
    return MOTOR.model_copy(update={"mqtt": mqtt})


OUTSIDE = "the shared supply is lost"

READS = count()


def now_s() -> float:
    """The time of the event loop, of which each look at the clock takes a microsecond."""
    return asyncio.get_running_loop().time() + 1e-6 * next(READS)


@pytest.fixture(autouse=True)
def _timers_of_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adaptdrive.runtime.daemon.TickTimer", LoopTimer)


class FailingPort(LoopbackPort):
    """A port that can be made to fail, at the start or later."""

    def __init__(self, commanded: Callable[[Command], None]) -> None:
        super().__init__(commanded)
        self.problem: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.fault_resets = 0
        self.keeps_fault = False

    async def reset_fault(self) -> None:
        self.fault_resets += 1
        if not self.keeps_fault:
            self.trip_cause = None

    async def run(self, listener: Listener, opened: Callable[[], None]) -> None:
        if self.problem.done():
            self.problem.result()
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(super().run(listener, opened))
            await self.problem


class DaemonBench:
    """A daemon and the drive behind it."""

    def __init__(self, manager: ServiceManager | None = None, report_s: float = 0.02) -> None:
        self.sent: list[Command] = []
        self.port = FailingPort(self.sent.append)
        self.controller = MotorController()
        self.hub = Hub()
        self._reports = self.hub.subscribe(StateReport, LoadReport, Event, size=10_000)
        self._told: list[Report] = []
        self.drive_reports = self.hub.subscribe(DriveReport, size=10_000)
        self.daemon = Daemon(
            port=self.port,
            controller=self.controller,
            configuration=telling(report_s),
            machine=MACHINE,
            fast=PATIENT,
            clock=now_s,
            hub=self.hub,
            manager=manager or ServiceManager({}),
            prepare=self.prepare,
        )
        self.stop = asyncio.Event()
        self.counter = 0
        self.task = asyncio.create_task(self.daemon.run(self.stop))

    @property
    def told(self) -> list[Report]:
        self._told += self._reports.drain()
        return self._told

    @property
    def states(self) -> list[StateReport]:
        return [report for report in self.told if isinstance(report, StateReport)]

    def events(self, kind: str) -> list[Event]:
        return [report for report in self.told if isinstance(report, Event) and report.kind == kind]

    def frame(self, **changes: object) -> None:
        arrival_s, self.counter = now_s(), self.counter + 1
        bridge = bool(self.sent) and self.sent[-1].bridge
        reading = replace(
            CALM, arrival_s=arrival_s, oldest_s=arrival_s, counter=self.counter, bridge=bridge
        )
        self.port.deliver(replace(reading, **changes))  # type: ignore[arg-type]

    def frames(self, count: int) -> None:
        for _ in range(count):
            self.frame()

    async def prepare(self, _: Reload) -> Callable[[], None]:
        """Read the file again, while something beside the drive fails."""
        self.daemon.trip(a_trip(OUTSIDE))
        return self.stop.set

    async def start(self) -> None:
        self.frames(3)
        await self.daemon.execute(Enable())
        self.frames(3)
        assert self.states[-1].state is State.RUNNING

    async def run_until_decided(self, periods: int = 1) -> None:
        """Run some slow periods, each decision in time."""
        for _ in range(periods):
            known = sum(isinstance(report, LoadReport) for report in self.told)
            self.frames(Q)
            await until(
                lambda known=known: (  # type: ignore[misc]
                    sum(isinstance(report, LoadReport) for report in self.told) > known
                )
            )

    async def end(self) -> None:
        """Ask the daemon to end; the drive goes on sending meanwhile."""
        self.stop.set()
        while not self.task.done():
            await asyncio.sleep(0.002)
            self.frame()
        await self.task


@contextlib.asynccontextmanager
async def daemon_bench(
    manager: ServiceManager | None = None, report_s: float = 0.02
) -> AsyncIterator[DaemonBench]:
    bench = DaemonBench(manager, report_s)
    try:
        await until(lambda: bench.port._up)
        yield bench
    finally:
        bench.task.cancel()
        await asyncio.wait([bench.task])
        bench.port.problem.cancel()


@contextlib.asynccontextmanager
async def running_daemon() -> AsyncIterator[DaemonBench]:
    """A daemon whose drive runs."""
    async with daemon_bench() as bench:
        await bench.start()
        yield bench


def leaves(group: BaseExceptionGroup[BaseException]) -> list[BaseException]:
    return [
        leaf
        for part in group.exceptions
        for leaf in (leaves(part) if isinstance(part, BaseExceptionGroup) else [part])
    ]


async def ending(bench: DaemonBench) -> list[BaseException]:
    """What the daemon died of."""
    with pytest.raises(BaseExceptionGroup) as caught:
        async with asyncio.timeout(20.0):
            await bench.task
    return leaves(caught.value)


async def test_the_state_is_reported_when_it_changes_and_only_then() -> None:
    async with running_daemon() as bench:
        await bench.daemon.execute(SetSetpoint(3.0))
        await bench.daemon.execute(SetSetpoint(3.0))
        await bench.daemon.execute(SetPole(0.8))
        bench.frames(200)
        await until(lambda: len(bench.drive_reports.drain()) > 0)
        states = bench.states
        assert all(a != b for a, b in pairwise(states))
        seen = [(report.state, report.setpoint, report.pole) for report in states]
        assert seen == [
            (State.STANDBY, 0.0, 0.7),
            (State.STANDBY, 0.0, 0.7),  # the drive has confirmed that it is off
            (State.STARTING, 2.3, 0.7),
            (State.RUNNING, 2.3, 0.7),
            (State.RUNNING, 3.0, 0.7),
            (State.RUNNING, 3.0, 0.8),
        ]
        details = [event.detail for event in bench.events("state")]
        assert details == ["standby to starting", "starting to running"]


async def test_only_the_operators_reset_lets_the_drive_leave_its_fault() -> None:
    async with running_daemon() as bench:
        bench.port.trip_cause = a_trip("drive fault")
        bench.frames(2)
        assert bench.states[-1].trip == "drive fault"
        for request in (Disable(), SetMode(Mode.ADAPTIVE)):
            await bench.daemon.execute(request)
        bench.frame()
        assert bench.port.fault_resets == 0
        assert await bench.daemon.execute(Reset()) is State.STANDBY
        assert bench.port.fault_resets == 1


async def test_a_drive_that_keeps_its_fault_refuses_the_reset() -> None:
    async with daemon_bench() as bench:
        bench.port.keeps_fault = True
        bench.frames(2)
        bench.port.trip_cause = a_trip("drive fault")
        with pytest.raises(RefusedError, match="drive fault"):
            await bench.daemon.execute(Enable())
        await bench.daemon.execute(Reset())  # nothing is latched here: standby is not left
        with pytest.raises(RefusedError, match="drive fault"):
            await bench.daemon.execute(Enable())
        assert set(bench.sent) == {SAFE_COMMAND}


async def test_a_flood_of_stops_does_not_fill_the_bus() -> None:
    async with daemon_bench() as bench:
        sent, began_s = len(bench.sent), now_s()
        for _ in range(10_000):
            bench.daemon.stop()
        assert 3 <= len(bench.sent) - sent <= 1 + (now_s() - began_s) / 0.004


async def test_a_daemon_that_shuts_down_only_stops() -> None:
    async with running_daemon() as bench:
        bench.stop.set()
        await until(lambda: bench.states[-1].shutting_down)
        bench.frames(3)
        with pytest.raises(RefusedError, match="shutting down"):
            await bench.daemon.execute(Enable())
        bench.daemon.stop()
        await bench.task
        assert bench.sent[-1] == SAFE_COMMAND


async def test_a_trip_is_an_alarm_and_stays_until_reset() -> None:
    async with running_daemon() as bench:
        bench.frame(fault=2)
        assert bench.sent[-1] == SAFE_COMMAND
        tripped = bench.states[-1]
        assert (tripped.state, tripped.trip) == (State.TRIPPED, "drive fault: word 0x2")
        assert not tripped.enabled
        (event,) = bench.events("trip")
        assert (event.severity, event.detail) == (Severity.ALARM, "drive fault: word 0x2")
        with pytest.raises(RefusedError, match="cause is still there: drive fault: word 0x2"):
            await bench.daemon.execute(Reset())
        bench.frame()
        assert await bench.daemon.execute(Reset()) is State.STANDBY
        assert bench.states[-1].trip is None


@pytest.mark.parametrize("trip", [None, OUTSIDE])
async def test_a_disable_and_a_trip_from_outside_wait_for_no_tick(trip: str | None) -> None:
    async with running_daemon() as bench:
        assert bench.sent[-1].bridge
        if trip:
            bench.daemon.trip(a_trip(trip))
        else:
            await bench.daemon.execute(Disable())
        assert bench.sent[-1] == SAFE_COMMAND
        assert bench.states[-1].trip == trip


async def test_a_trip_while_the_file_is_read_again_stays_and_ends_the_reload() -> None:
    async with daemon_bench() as bench:
        bench.frames(3)
        with pytest.raises(RefusedError, match="state is tripped"):
            await bench.daemon.execute(Reload())
        assert not bench.stop.is_set()
        assert bench.states[-1].trip == OUTSIDE


async def test_the_confirmation_of_a_stop_is_reported_when_the_drive_gives_it() -> None:
    async with daemon_bench(report_s=1e6) as bench:
        bench.frames(3)
        assert bench.states[-1].stop is StopWord.CONFIRMED
        await bench.start()
        bench.frame(fault=2, bridge=True)
        known = len(bench.states)
        assert (bench.states[-1].state, bench.states[-1].stop) == (
            State.TRIPPED,
            StopWord.AWAITED,
        )
        bench.frame(bridge=True)
        bench.frame(bridge=False)
        bench.frames(10)
        (confirmed,) = bench.states[known:]
        assert confirmed.stop is StopWord.CONFIRMED


async def test_the_mode_is_an_event_and_says_why_it_is_not_in_force() -> None:
    async with daemon_bench() as bench:
        await bench.daemon.execute(SetMode(Mode.ADAPTIVE))
        assert [event.detail for event in bench.events("mode")] == ["mode fixed to adaptive"]
        assert bench.states[-1].reason == "not running"
        await bench.start()
        assert bench.states[-1].state is State.RUNNING
        assert bench.states[-1].reason == "waiting for the first slow period of this run"
        await bench.run_until_decided()
        state = bench.states[-1]
        assert (state.mode, state.controller) == (Mode.ADAPTIVE, Mode.FIXED)
        load = next(report for report in bench.told if isinstance(report, LoadReport))
        assert state.reason == load.decision.reason != ""


async def test_taking_over_and_falling_back_are_events() -> None:
    async with daemon_bench() as bench:
        await bench.daemon.execute(SetMode(Mode.ADAPTIVE))
        await bench.start()
        bench.controller.revise = lambda made: replace(made, controller=Mode.ADAPTIVE, reason="")
        await bench.run_until_decided()
        assert bench.states[-1].controller is Mode.ADAPTIVE
        assert [event.detail for event in bench.events("controller")] == [
            "adaptive controller in force"
        ]
        bench.controller.revise = lambda made: replace(made, reason="estimate is not finite")
        await bench.run_until_decided()
        (fallback,) = bench.events("fallback")
        assert (fallback.severity, fallback.detail) == (
            Severity.WARNING,
            "estimate is not finite",
        )
        assert bench.states[-1].reason == "estimate is not finite"


@pytest.mark.parametrize(
    ("found", "trip"),
    [
        ({"fault": "cell too warm", "fault_kind": "no-current"}, "cell too warm"),
        ({"complete": True}, None),
    ],
)
async def test_a_load_with_a_fault_trips_and_one_that_has_enough_is_switched_off(
    found: dict[str, object], trip: str | None
) -> None:
    async with running_daemon() as bench:
        bench.controller.revise = lambda made: replace(made, **found)  # type: ignore[arg-type]
        await bench.run_until_decided()
        assert bench.sent[-1] == SAFE_COMMAND
        bench.frames(3)
        assert set(bench.sent[-3:]) == {SAFE_COMMAND}
        assert (bench.states[-1].enabled, bench.states[-1].trip) == (False, trip)


async def test_losing_the_bus_and_its_return_are_events() -> None:
    async with daemon_bench() as bench:
        bench.port.lose("unplugged")
        bench.port.restore()
        told = [(event.severity, event.detail) for event in bench.events("bus")]
        assert told == [(Severity.WARNING, "unplugged"), (Severity.INFO, "loopback")]


async def test_an_orderly_stop_says_goodbye_more_than_once() -> None:
    async with running_daemon() as bench:
        running = len(bench.sent)
        await bench.end()
        farewell = bench.sent[running:]
        assert len(farewell) >= 3
        assert set(farewell) == {SAFE_COMMAND}
        assert bench.states[-1].state is State.STANDBY


async def test_an_orderly_stop_waits_for_the_drives_word() -> None:
    async with running_daemon() as bench:
        bench.stop.set()
        for _ in range(30):
            await asyncio.sleep(0.002)
            bench.frame(bridge=True)
        assert not bench.task.done()
        await bench.end()
        assert bench.states[-1].stop is StopWord.CONFIRMED


async def test_when_the_slow_loop_dies_the_drive_is_left_safe() -> None:
    async with running_daemon() as bench:

        def fail(made: Decision) -> Decision:
            raise ArithmeticError(f"no decision for k = {made.k}")

        bench.controller.revise = fail
        assert bench.sent[-1].bridge
        bench.frames(Q)
        assert bench.sent[-1].bridge
        (cause,) = await ending(bench)
        assert isinstance(cause, ArithmeticError)
        assert bench.sent[-1] == SAFE_COMMAND


async def test_when_the_reports_die_the_drive_is_left_safe(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with running_daemon() as bench:
        monkeypatch.setattr("adaptdrive.runtime.accounts.drive_report", lambda *_: 1 / 0)
        (cause,) = await ending(bench)
        assert isinstance(cause, ZeroDivisionError)
        assert bench.sent[-1] == SAFE_COMMAND


async def test_when_a_stand_in_tick_fails_the_daemon_ends_and_the_drive_is_left_safe(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with running_daemon() as bench:

        def fail() -> None:
            raise ArithmeticError("no frame can be read")

        monkeypatch.setattr(bench.port, "catch_up", fail)
        bench.daemon.arm(now_s())
        (cause,) = await ending(bench)
        assert isinstance(cause, ArithmeticError)
        assert bench.sent[-1] == SAFE_COMMAND


async def test_when_a_tick_fails_the_daemon_ends_and_the_drive_is_left_safe() -> None:
    async with running_daemon() as bench:

        def fail(measurement: Measurement, _order: Order) -> Command:
            raise ZeroDivisionError(f"no command at tick {measurement.tick}")

        sound, bench.controller.replace_tick = bench.controller.replace_tick, fail
        bench.frame()
        assert bench.sent[-1] == SAFE_COMMAND
        known, bench.controller.replace_tick = len(bench.sent), sound
        bench.frame(bridge=True)
        assert str(bench.states[-1].trip).startswith("internal error: ZeroDivisionError('no comm")
        (cause,) = await ending(bench)
        assert isinstance(cause, ZeroDivisionError)
        assert len(bench.sent) >= known + 3
        assert set(bench.sent[known:]) == {SAFE_COMMAND}


@pytest.mark.parametrize("where", ["callback", "thread"])
async def test_an_error_that_nobody_catches_ends_the_daemon(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(threading, "excepthook", lambda _: None)  # pytest would fail the test
    async with running_daemon() as bench:
        with uncaught_errors_end(bench.daemon.fail):
            if where == "callback":
                asyncio.get_running_loop().call_soon(lambda: 1 / 0)
            else:
                thread = threading.Thread(target=lambda: 1 / 0)
                thread.start()
                thread.join()
            (cause,) = await ending(bench)
        assert isinstance(cause, ZeroDivisionError)
        assert bench.sent[-1] == SAFE_COMMAND


async def test_when_it_is_cancelled_the_drive_is_left_safe() -> None:
    async with running_daemon() as bench:
        assert bench.sent[-1].bridge
        bench.task.cancel()
        await asyncio.wait([bench.task])
        assert bench.task.cancelled()
        assert bench.sent[-1] == SAFE_COMMAND


async def test_a_bus_that_cannot_be_opened_ends_the_daemon() -> None:
    bench = DaemonBench()
    bench.port.problem.set_exception(BusError("socketcan can0", "there is no such interface"))
    (cause,) = await ending(bench)
    assert isinstance(cause, BusError)
    assert bench.sent == []
