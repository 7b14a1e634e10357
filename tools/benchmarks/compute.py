"""What a tick, a slow step and a frame cost, without a clock and without a wire."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import can
import numpy as np
import padasip

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, fast_settings, machine_limits
from adaptdrive.control.controller import Controller
from adaptdrive.control.estimation import rls
from adaptdrive.control.signals import (
    Command,
    Measurement,
    Mode,
    Order,
    Snapshot,
    Stage,
)
from adaptdrive.devices.can import port as can_port
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.safety.facts import Reading
from tests.loopback_port import LoopbackPort, Quiet
from tests.unit.devices.bench import EXAMPLES, LOAD, MOTOR, MOTOR_BUS, TIMING, Drive
from tools.benchmarks.rows import Extent, Row, alternating, quantile

Array = np.ndarray[tuple[int, int], np.dtype[np.float64]]
Job = Callable[[], object]

TICK_US = 0.5e6 / MOTOR.drive.line_frequency_Hz
CALLS, ROUNDS = 2000, 21
WARM_UP = 80
"""Readings before the measurement: a drive is enabled when its frame rate has been judged."""
ENABLED = WARM_UP - 8
"""Reading after which the drive is enabled; its bridge is on two readings later."""
COLD = 300
"""Ticks that are run with cold caches."""


def rows(_: Extent) -> Iterator[Row]:
    """All rows of this file."""
    yield from _estimator(3)
    yield from _tick()
    yield from _frames()


# -- estimator -------------------------------------------------------------------------------


def _estimator(size: int) -> Iterator[Row]:
    source = np.random.default_rng(1)
    regressors = source.normal(size=(997, size))
    targets = [float(one) for one in regressors @ source.normal(size=size)]
    jobs = [
        _ours(regressors.tolist(), targets),
        _padasip(regressors, targets),
        _textbook(regressors, targets),
    ]
    ours, peer, textbook = alternating(jobs, CALLS, ROUNDS)
    name, faster = f"RLS update, n = {size}", "at least 5 times faster"
    yield Row(name, ours, "us", peer, "padasip FilterRLS", faster, 5.0 * ours <= peer)
    yield Row(name, ours, "us", textbook, "textbook form in numpy")


def _ours(regressors: list[list[float]], targets: list[float]) -> Job:
    own = rls.Estimate(len(regressors[0]))
    own.open_up(1e4)
    samples = itertools.cycle(zip(regressors, targets, strict=True))
    return lambda: own.update(*next(samples), 0.97)


def _padasip(regressors: Array, targets: list[float]) -> Job:
    adaptive = padasip.filters.FilterRLS(n=regressors.shape[1], mu=0.97)
    samples = itertools.cycle(zip(targets, regressors, strict=True))
    return lambda: adaptive.adapt(*next(samples))


def _textbook(regressors: Array, targets: list[float]) -> Job:
    size = regressors.shape[1]
    theta, covariance = np.zeros(size), 1e4 * np.eye(size)
    samples = itertools.cycle(zip(regressors, targets, strict=True))

    def job() -> object:
        nonlocal theta, covariance
        r, target = next(samples)
        gain = covariance @ r / (0.97 + r @ covariance @ r)
        theta = theta + gain * (target - r @ theta)
        covariance = (covariance - np.outer(gain, r) @ covariance) / 0.97
        return theta

    return job


# -- the tick --------------------------------------------------------------------------------


class Kept(Quiet):
    """Surroundings of a fast loop that keep the last snapshot alone."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.snapshot: Snapshot | None = None

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        self.snapshot = snapshot
        return True


CALM = Reading(0.0, 0.0, 0, 300.1, 120.4, 431.7, 3.12, 0, True)


def running_controller() -> tuple[Controller, Order]:
    """A controller in stage RUN, and the order that keeps it there."""
    controller = Controller(controller_settings(MOTOR), build_load(MOTOR))
    order = Order(Stage.RUN, 3.1, Mode.ADAPTIVE, MOTOR.load.pole)
    return controller, order


def _tick() -> Iterator[Row]:
    controller, order = running_controller()
    plain, slow = _times_of_ticks(controller, order)
    median = quantile(plain, 0.5)
    note = f"{median / TICK_US:.2%} of the half cycle; p99 {quantile(plain, 0.99):.1f} us"
    yield Row("controller alone: voltage loop, filters", median, "us", note=note)
    yield _whole_tick()
    note = f"p99 {quantile(slow, 0.99):.0f} us; once per {MOTOR.ticks_per_period} ticks"
    median = quantile(slow, 0.5)
    yield Row("slow step: estimate, supervise, design", median, "us", note=note)


def _times_of_ticks(controller: Controller, order: Order) -> tuple[list[float], list[float]]:
    plain, slow = [], []
    for n in range(12_000):
        output = 3.1 + 0.05 * math.sin(0.001 * n)
        measurement = Measurement(n, TICK_US * 1e-6, 300.1, 120.4, 431.7, output)
        began_s = time.perf_counter()
        controller.tick(measurement, order)
        plain.append((time.perf_counter() - began_s) * 1e6)
        snapshot = controller.take_snapshot()
        if snapshot is not None:
            began_s = time.perf_counter()
            controller.apply(controller.decide(snapshot))
            slow.append((time.perf_counter() - began_s) * 1e6)
    return plain, slow


def running_loop(send: Callable[[Command], None]) -> tuple[FastLoop, Kept]:
    """A fast loop in state running on a port without a wire."""
    quiet = Kept()
    machine = Machine(machine_limits(MOTOR))
    controller = Controller(controller_settings(MOTOR), build_load(MOTOR))
    port = LoopbackPort(send, counter_modulus=65536)
    port.restore()
    loop = FastLoop(port, controller, machine, fast_settings(MOTOR), quiet)
    for number in range(WARM_UP):
        feed(loop, quiet, number, bridge=number > ENABLED + 1)
        if number == ENABLED:
            machine.carry_out(Enable(), loop.tick, 3.1, loop.cause)
    assert machine.state is State.RUNNING, machine.trip
    return loop, quiet


def feed(loop: FastLoop, quiet: Kept, number: int, *, bridge: bool) -> None:
    """The next reading, a half cycle after the last."""
    quiet.now += TICK_US * 1e-6
    now_s = quiet.now
    counter = number % 65536
    reading = replace(CALM, arrival_s=now_s, oldest_s=now_s, counter=counter, bridge=bridge)
    loop.on_reading(reading)


def _whole_tick() -> Row:
    sent: list[Command] = []
    loop, quiet = running_loop(sent.append)
    times = []
    for number in range(WARM_UP, WARM_UP + 12_000):
        quiet.now += TICK_US * 1e-6
        now_s = quiet.now
        reading = replace(CALM, arrival_s=now_s, oldest_s=now_s, counter=number % 65536)
        began_s = time.perf_counter()
        loop.on_reading(reading)
        times.append((time.perf_counter() - began_s) * 1e6)
        if quiet.snapshot is not None:
            quiet.snapshot = None
        sent.clear()
        if number % 12 == 0:  # as the daemon reports ten times a second
            for window in (loop.lateness, loop.turnaround, loop.tick_time):
                window.take()
    median = quantile(times, 0.5)
    note = f"{median / TICK_US:.2%} of the half cycle; p99 {quantile(times, 0.99):.1f} us"
    name = "whole tick: time base, interlocks, controller, guard, report"
    return Row(name, median, "us", note=note)


# -- the wire --------------------------------------------------------------------------------


class _Frames(can.BusABC):
    """A bus that keeps nothing; it only counts."""

    def __init__(self) -> None:
        self.frames: list[can.Message] = []
        super().__init__(channel="benchmark")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.frames.append(msg)


def status_frames(count: int, off: int = 0) -> list[tuple[can.Message, can.Message]]:
    """Frames of so many half cycles, made by cantools and crccheck; the bridge is off at first."""
    bus = _Frames()
    drive = Drive(bus)
    for index in range(count):
        drive.send_status(BridgeOn=float(index >= off))
        drive.send_load(Tachometer=LOAD["Tachometer"])
    bus.shutdown()
    return list(zip(bus.frames[::2], bus.frames[1::2], strict=True))


class _Clocked:
    """A listener that runs the ticks of a fast loop, and a clock."""

    def __init__(self) -> None:
        self.quiet = Kept()
        self.loop: FastLoop | None = None

    def on_reading(self, reading: Reading) -> None:
        if self.loop is not None:
            self.loop.on_reading(reading)

    def on_bus(self, up: bool, detail: str) -> None: ...


def _frames() -> Iterator[Row]:
    listener, bus = _Clocked(), _Frames()
    source = EXAMPLES / "motor.toml"
    mapping = map_drive(MOTOR_BUS, MOTOR.signals, TIMING, source)
    clock = lambda: listener.quiet.now  # noqa: E731 - both clocks of the port
    port = can_port.Port(MOTOR_BUS, mapping, clock, clock)
    port._connection.listener, port._connection.bus = listener, bus
    enabled = 3000 + WARM_UP
    pairs = status_frames(8000, enabled + 2)
    decode = _times_of_pairs(port.take, listener, pairs[:3000])
    command = Command(0.0512, 301.25, True)
    encode = []
    for _ in range(6000):
        began_s = time.perf_counter()
        port.send(command)
        encode.append((time.perf_counter() - began_s) * 1e6)
    machine = Machine(machine_limits(MOTOR))
    controller = Controller(controller_settings(MOTOR), build_load(MOTOR))
    listener.loop = FastLoop(port, controller, machine, fast_settings(MOTOR), listener.quiet)
    _times_of_pairs(port.take, listener, pairs[3000:enabled])
    machine.carry_out(Enable(), listener.loop.tick, 3.1, listener.loop.cause)
    whole = _times_of_pairs(port.take, listener, pairs[enabled:-COLD])
    cold = _times_of_pairs(port.take, listener, pairs[-COLD:], between=_flush)
    assert machine.state is State.RUNNING, machine.trip
    bus.shutdown()
    for name, times in (("decode two frames", decode), ("encode one frame", encode)):
        median = quantile(times, 0.5)
        note = f"{median / TICK_US:.2%} of the half cycle; p99 {quantile(times, 0.99):.1f} us"
        yield Row(name, median, "us", note=note)
    median = quantile(whole, 0.5)
    note = f"{median / TICK_US:.2%} of the half cycle; p99 {quantile(whole, 0.99):.1f} us"
    name = "tick with decode of two frames and encode of one"
    yield Row(name, median, "us", target="at most 15 us", met=median <= 15.0, note=note)
    note = "other work has filled the caches between two ticks"
    yield Row("the same with cold caches", quantile(cold, 0.5), "us", note=note)


_MUCH = np.zeros(4 * 2**20)


def _flush() -> None:
    """Push everything out of the caches."""
    np.add(_MUCH, 1.0, out=_MUCH)


def _times_of_pairs(
    take: Callable[[can.Message], None],
    listener: _Clocked,
    pairs: list[tuple[can.Message, can.Message]],
    between: Callable[[], None] = lambda: None,
) -> list[float]:
    times = []
    for status, load in pairs:
        between()
        listener.quiet.now += TICK_US * 1e-6
        status.timestamp = load.timestamp = listener.quiet.now
        began_s = time.perf_counter()
        take(status)
        take(load)
        times.append((time.perf_counter() - began_s) * 1e6)
    return times
