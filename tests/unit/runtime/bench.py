"""A fast loop on a loopback bus, in a time that the test sets; the drive on it obeys."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, fast_settings, machine_limits
from adaptdrive.config import load_configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import (
    Command,
    Decision,
    Measurement,
    Mode,
    Order,
    Snapshot,
    Stage,
)
from adaptdrive.runtime.daemon import Daemon
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.reports import Hub, State, TickReport
from adaptdrive.runtime.requests import Enable, Request
from adaptdrive.runtime.settings import FastLoopSettings, MachineLimits
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.runtime.tick_support import ServiceManager
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.trips import Trip
from tests.loopback_port import LoopbackPort

MOTOR = load_configuration(Path(__file__).parents[3] / "deploy" / "examples" / "motor.toml")
MACHINE: MachineLimits = machine_limits(MOTOR)
FAST: FastLoopSettings = replace(fast_settings(MOTOR), charges_capacitor=False)  # v_bst is scripted
TICK_S = FAST.timing.half_cycle_s
Q = MOTOR.ticks_per_period
LATENCY = FAST.latency_ticks
PATIENCE_S = 120.0
RATE_FRAMES = 61
"""Readings from which the rate is judged."""

CALM = Reading(
    arrival_s=0.0,
    oldest_s=0.0,
    counter=0,
    boost_voltage_V=210.0,
    line_voltage_V=120.0,
    load_power_W=300.0,
    output=2.3,
    fault=0,
    bridge=False,
)


class MotorController:
    """The controller of the example configuration; a test may change what it returns."""

    def __init__(self) -> None:
        self.inner = Controller(controller_settings(MOTOR), build_load(MOTOR))
        self.replace_tick: Callable[[Measurement, Order], Command] = self.inner.tick
        self.revise: Callable[[Decision], Decision] = lambda decision: decision

    def tick(self, measurement: Measurement, order: Order) -> Command:
        return self.replace_tick(measurement, order)

    def take_snapshot(self) -> Snapshot | None:
        return self.inner.take_snapshot()

    def decide(self, snapshot: Snapshot) -> Decision:
        return self.revise(self.inner.decide(snapshot))

    def apply(self, decision: Decision) -> None:
        self.inner.apply(decision)


def decision(k: int, boost_reference_V: float, **changes: object) -> Decision:
    """A decision for the boost voltage alone."""
    plain = Decision(
        k=k,
        boost_reference_V=boost_reference_V,
        controller=Mode.FIXED,
        accepted=False,
        reason="",
        estimates={},
        gains=(),
        innovation=0.0,
        excitation=0.0,
        handover_step_V=math.nan,
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


def snapshot(k: int, period_ticks: int = Q) -> Snapshot:
    """A snapshot of a motor that follows its reference."""
    order = Order(Stage.RUN, 3.0, Mode.FIXED, 0.7)
    chain = (300.0, 300.0, 300.0)
    return Snapshot(k, period_ticks * k, 1.0, order, 2.9, (2.9, 2.9), chain, 301.0, True, 0)


@dataclass
class Around:
    """What surrounds the fast loop: a clock that stands still, and notes of what it was told."""

    now: float = 1000.0
    deadline_s: float = math.inf
    fed: list[float] = field(default_factory=list)
    reports: list[TickReport] = field(default_factory=list)
    snapshots: list[Snapshot] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    not_stops: list[Trip] = field(default_factory=list)
    room: bool = True
    runs_ended: int = 0

    def now_s(self) -> float:
        return self.now

    def arm(self, deadline_s: float) -> None:
        self.deadline_s = deadline_s

    def met_deadline(self, now_s: float) -> None:
        self.fed.append(now_s)

    def ticked(self, report: TickReport) -> None:
        self.reports.append(report)

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        self.snapshots.append(snapshot)
        return self.room

    def decided(self, snapshot: Snapshot, decision: Decision) -> None:
        self.decisions.append(decision)

    def not_stopped(self, problem: Trip) -> None:
        self.not_stops.append(problem)

    def run_ended(self) -> None:
        self.runs_ended += 1


class FastBench:
    """A fast loop, its drive, and the time between them."""

    def __init__(
        self,
        settings: FastLoopSettings = FAST,
        modulus: int | None = 65536,
        slack_s: float | None = 0.0,
    ) -> None:
        self.around = Around()
        self.sent: list[Command] = []
        self.port = LoopbackPort(
            self._command, counter_modulus=modulus, timing=settings.timing, slack_s=slack_s
        )
        self.machine = Machine(MACHINE)
        self.controller = MotorController()
        self.loop = FastLoop(self.port, self.controller, self.machine, settings, self.around)
        self.unsendable: Callable[[Command], bool] = lambda _: False
        self.counter = 0
        self.measured = CALM

    @property
    def reports(self) -> list[TickReport]:
        return self.around.reports

    @property
    def ticks(self) -> list[int]:
        return [report.measurement.tick for report in self.reports]

    def _command(self, command: Command) -> None:
        if self.unsendable(command):
            raise ValueError(f"k = {command.current_scale_S} S does not fit into its signal")
        self.sent.append(command)

    def on_reading(self, reading: Reading) -> None:
        """Pass a reading from the port on."""
        self.loop.on_reading(reading)

    def on_bus(self, up: bool, detail: str) -> None:
        """Nothing here depends on it."""

    def wait(self, seconds: float) -> None:
        """Let time pass; the timer expires when it is due."""
        around = self.around
        end_s = around.now + seconds
        while around.deadline_s < end_s:
            around.now = around.deadline_s
            self.loop.on_deadline(around.deadline_s)
        around.now = end_s

    def oversleep(self, seconds: float) -> None:
        """Let time pass while nothing runs, and the timer expire so long after its deadline."""
        deadline_s = self.around.deadline_s
        self.around.now = deadline_s + seconds
        self.loop.on_deadline(deadline_s)

    def thaw(self, frozen_s: float, *, bridge: bool = False) -> None:
        """Let time pass while nothing runs, and a frame that waited be the first that is seen."""
        self.around.now += frozen_s
        self.counter += round(frozen_s / TICK_S)
        now_s = self.around.now
        frame = replace(self.measured, arrival_s=now_s, oldest_s=now_s, bridge=bridge)
        self.port.deliver(replace(frame, counter=self.counter % 65536))

    def stand_still_in_ticks(self, seconds: float) -> None:
        """Let each tick stand still from now on, before it has its command."""
        decide = self.controller.replace_tick

        def decide_late(measurement: Measurement, order: Order) -> Command:
            self.around.now += seconds
            return decide(measurement, order)

        self.controller.replace_tick = decide_late

    def slow_down(self, monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
        """Let each command take so long from now on."""
        send = self.port.send

        def send_slowly(command: Command) -> bool:
            self.around.now += seconds
            return send(command)

        monkeypatch.setattr(self.port, "send", send_slowly)

    def stand_still_in_next_command(self, seconds: float) -> None:
        """Let the next command stand still on its way to the bus."""
        known = len(self.sent)

        def stand_still(_: Command) -> bool:
            self.around.now += seconds if len(self.sent) == known else 0.0
            return False

        self.unsendable = stand_still

    def frame(self, after_s: float = TICK_S, steps: int = 1, **changes: object) -> None:
        """Deliver the frame of a later half cycle; the drive's bridge is as it was commanded."""
        self.wait(after_s)
        self.counter += steps
        bridge = bool(self.sent) and self.sent[-1].bridge
        reading = replace(
            self.measured,
            arrival_s=self.around.now,
            oldest_s=self.around.now,
            counter=self.counter % 65536,
            bridge=bridge,
        )
        self.port.deliver(replace(reading, **changes))  # type: ignore[arg-type]

    def frames(
        self, count: int, after_s: float = TICK_S, steps: int = 1, **changes: object
    ) -> None:
        """Deliver so many such frames, each half cycle unless another time is given."""
        for _ in range(count):
            self.frame(after_s, steps, **changes)

    def ask(self, request: Request) -> None:
        """Carry out an operator's request between two ticks."""
        reading = self.loop.reading
        output = reading.output if reading else math.nan
        self.machine.carry_out(request, self.loop.tick, output, self.loop.cause)

    def state(self) -> State:
        """Where the state machine is now."""
        return self.machine.state

    @property
    def trip(self) -> str:
        """Why it has tripped; empty while it has not."""
        return "" if self.machine.trip is None else self.machine.trip.text

    def start(self) -> None:
        """Wait until the frame rate is known, enable the drive and wait until it runs."""
        self.frames(RATE_FRAMES)
        self.ask(Enable())
        self.frames(3)
        assert self.state() is State.RUNNING

    def run_to_snapshot(self) -> Snapshot:
        """Run until the next snapshot."""
        known = len(self.around.snapshots)
        while len(self.around.snapshots) == known:
            self.frame()
        return self.around.snapshots[-1]


@contextlib.asynccontextmanager
async def fast_bench(
    settings: FastLoopSettings = FAST,
    modulus: int | None = 65536,
    slack_s: float | None = 0.0,
) -> AsyncIterator[FastBench]:
    """Open a bench; its drive speaks of its bridge, unless `slack_s` is None."""
    bench = FastBench(settings, modulus, slack_s)
    serving = asyncio.create_task(bench.port.run(bench, bench.loop.begin))
    try:
        await asyncio.sleep(0)
        yield bench
    finally:
        serving.cancel()
        await asyncio.wait([serving])


@contextlib.asynccontextmanager
async def running_bench(
    settings: FastLoopSettings = FAST,
    modulus: int | None = 65536,
    slack_s: float | None = 0.0,
    *,
    frames: int = 0,
) -> AsyncIterator[FastBench]:
    """Open a bench whose drive has come to run, and has sent so many frames since."""
    async with fast_bench(settings, modulus, slack_s) as bench:
        bench.start()
        bench.frames(frames)
        yield bench


class LoopTimer:
    """Keeps deadlines by the clock of the event loop, in place of the kernel's timer."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[float], None]) -> None:
        self._loop, self._callback = loop, callback
        self._handle: asyncio.TimerHandle | None = None

    def arm(self, deadline_s: float) -> None:
        self.close()
        self._handle = self._loop.call_at(deadline_s, self._callback, deadline_s)

    def close(self) -> None:
        if self._handle is not None:
            self._handle.cancel()


def timed(**changes: float | None) -> FastLoopSettings:
    """The settings with other times."""
    return replace(FAST, timing=replace(FAST.timing, **changes))  # type: ignore[arg-type]


def idle_daemon(
    machine: Machine,
    fast: FastLoop,
    clock: Callable[[], float],
    controller: MotorController | None = None,
) -> Daemon:
    """Return a daemon that does not run, with a machine and a fast loop of the test."""
    daemon = Daemon(
        port=LoopbackPort(lambda _: None),
        controller=controller or MotorController(),
        configuration=MOTOR,
        machine=MACHINE,
        fast=FAST,
        clock=clock,
        hub=Hub(),
        manager=ServiceManager({}),
    )
    daemon._machine, daemon._fast = machine, fast
    return daemon


async def until(condition: Callable[[], bool]) -> None:
    """Wait until something is true."""
    async with asyncio.timeout(PATIENCE_S):
        while not condition():  # noqa: ASYNC110 - it may be anything
            await asyncio.sleep(0.005)
