"""What the steps of a daemon cost in one process, without a clock and without a wire.

`steps.py COUNT` prints the alternations of each row as JSON. Each is the median of many calls.
"""

from __future__ import annotations

import csv
import io
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from itertools import count, cycle, islice
from statistics import median

import can
import numpy as np

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, fast_settings, machine_limits
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Measurement, Mode, Order, Stage
from adaptdrive.devices.can import port as can_port
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.recording.records import packed_ticks
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.reports import TICK_COLUMNS, State, TickReport
from adaptdrive.runtime.requests import Enable
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.safety.facts import Reading
from tests.unit.devices.bench import EXAMPLES, MOTOR, MOTOR_BUS, TIMING
from tools.benchmarks.frames import Frames, half_cycles
from tools.benchmarks.paired.pairs import Effort, Row, Turn, take_turns
from tools.benchmarks.paired.script import Control
from tools.benchmarks.timer_ticks import Kept

HALF_CYCLES, COLD = 300, 20
"""Half cycles of one measurement, with warm and with cold caches."""

WARM_UP = 80
"""Readings before the measurement: a drive is enabled when its frame rate has been judged."""

SLICE, ROUNDS = 50, 100
"""Reports that the recorder packs at once, and how often it does so in one measurement."""

SLOW_STEPS = 52
"""A period of the output, in which some steps learn and others do not."""

_MUCH = np.zeros(4 * 2**20)

TICK, COLD_TICK = "tick with its frames", "the same, cold caches"
SLOW_STEP, LOG_ROW = "slow step", "row of the log"
AGAINST = {
    TICK: "the script's step",
    COLD_TICK: "the script's step",
    SLOW_STEP: "padasip's RLS",
    LOG_ROW: "row of csv",
}


class _Clocked(Kept):
    """A listener that runs the ticks of a fast loop, and a clock."""

    def __init__(self) -> None:
        super().__init__()
        self.loop: FastLoop | None = None
        self.reports: list[TickReport] = []

    def on_reading(self, reading: Reading) -> None:
        if self.loop is not None:
            self.loop.on_reading(reading)

    def on_bus(self, up: bool, detail: str) -> None: ...

    def ticked(self, report: TickReport) -> None:
        self.reports.append(report)


class Daemon:
    """A fast loop in state running behind the CAN port of the reference drive."""

    def __init__(self) -> None:
        self._around, self._bus = _Clocked(), Frames()
        mapping = map_drive(MOTOR_BUS, MOTOR.signals, TIMING, EXAMPLES / "motor.toml")
        clock = lambda: self._around.now  # noqa: E731 - both clocks of the port
        port = can_port.Port(MOTOR_BUS, mapping, clock, clock)
        port._connection.listener, port._connection.bus = self._around, self._bus
        machine = Machine(machine_limits(MOTOR))
        controller = Controller(controller_settings(MOTOR), build_load(MOTOR))
        self._loop = FastLoop(port, controller, machine, fast_settings(MOTOR), self._around)
        self._around.loop, self._take = self._loop, port.take
        self._pairs = half_cycles(WARM_UP + 2)
        self.run(WARM_UP)
        machine.carry_out(Enable(), self._loop.tick, 3.1, self._loop.cause)
        self.run(WARM_UP)
        assert machine.state is State.RUNNING, machine.trip

    def run(self, count: int, between: Callable[[], object] = lambda: None) -> float:
        """Run half cycles; return the median time of their frames, in microseconds."""
        times = []
        for pair in islice(self._pairs, count):
            self._around.now += MOTOR.drive.half_cycle_s
            between()
            times.append(timed(self._take, pair, self._around.now))
        for window in (self._loop.lateness, self._loop.turnaround, self._loop.tick_time):
            window.take()
        self._bus.frames.clear()
        return median(times)

    def reports(self, count: int) -> list[TickReport]:
        """Return the reports of so many half cycles."""
        self._around.reports.clear()
        self.run(count)
        return list(self._around.reports)


class Script:
    """The step of the script of an afternoon, without its bus and its table."""

    def __init__(self) -> None:
        self._control = Control(lambda _: None, lambda _: None)
        self._pairs, self._now = half_cycles(), 0.0

    def run(self, count: int, between: Callable[[], object] = lambda: None) -> float:
        """Run half cycles; return the median time of their frames, in microseconds."""
        times = []
        for pair in islice(self._pairs, count):
            self._now += MOTOR.drive.half_cycle_s
            between()
            times.append(timed(self._control.take, pair, self._now))
        return median(times)


def timed(
    take: Callable[[can.Message], object], pair: tuple[can.Message, can.Message], now_s: float
) -> float:
    """Return how long two frames take, in microseconds."""
    status, load = pair
    status.timestamp = load.timestamp = now_s
    began_s = time.perf_counter()
    take(status)
    take(load)
    return (time.perf_counter() - began_s) * 1e6


def flush() -> None:
    """Push everything out of the caches."""
    np.add(_MUCH, 1.0, out=_MUCH)


def slow_steps() -> Callable[[], float]:
    """Return a job that runs slow steps; it returns their median time, in microseconds."""
    controller = Controller(controller_settings(MOTOR), build_load(MOTOR))
    order = Order(Stage.RUN, 3.1, Mode.ADAPTIVE, MOTOR.load.pole)
    ticks = count()

    def run() -> float:
        times: list[float] = []
        while len(times) < SLOW_STEPS:
            n = next(ticks)
            output = 3.1 + 0.05 * math.sin(0.001 * n)
            tick_s = MOTOR.drive.half_cycle_s
            controller.tick(Measurement(n, tick_s, 300.1, 120.4, 431.7, output), order)
            if (snapshot := controller.take_snapshot()) is not None:
                began_s = time.perf_counter()
                controller.apply(controller.decide(snapshot))
                times.append((time.perf_counter() - began_s) * 1e6)
        return median(times)

    return run


def updates() -> Callable[[], float]:
    """Return a job that updates an estimate of padasip; it returns the median time."""
    source = np.random.default_rng(1)
    regressors, targets = source.normal(size=(997, 3)), source.normal(size=997)
    import padasip  # noqa: PLC0415 - for the process that measures: its first import warns

    adaptive = padasip.filters.FilterRLS(n=3, mu=0.97)
    samples = cycle(zip(targets, regressors, strict=True))

    def run() -> float:
        times = []
        for target, regressor in islice(samples, 10 * SLOW_STEPS):
            began_s = time.perf_counter()
            adaptive.adapt(target, regressor)
            times.append((time.perf_counter() - began_s) * 1e6)
        return median(times)

    return run


def per_row(write: Callable[[], object]) -> float:
    """Return the median time of a row, in microseconds, of a job that takes a slice of rows."""
    times = []
    for _ in range(ROUNDS):
        began_s = time.perf_counter()
        write()
        times.append((time.perf_counter() - began_s) / SLICE * 1e6)
    return median(times)


def as_csv(reports: list[TickReport]) -> None:
    """Write the columns of the log as a table of csv."""
    writer = csv.writer(io.StringIO())
    for report in reports:
        writer.writerow([column.read(report) for column in TICK_COLUMNS])


def rows(environments: dict[str, dict[str, str]], effort: Effort) -> Iterator[Row]:
    """Rows of all builds, each measured in a process of its own."""
    for build, environment in environments.items():
        command = [sys.executable, "-m", "tools.benchmarks.paired.steps", str(effort.turns)]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, env=environment)
        for name, turns in json.loads(done.stdout).items():
            most = 15.0 if name == TICK else None
            yield Row(name, build, "us", AGAINST[name], [Turn(**one) for one in turns], most=most)


def main(turns: int) -> dict[str, tuple[Turn, ...]]:
    """Measure so many alternations of each row."""
    daemon, script = Daemon(), Script()
    reports = daemon.reports(SLICE)
    pairs: dict[str, tuple[Callable[[], float], Callable[[], float]]] = {
        TICK: (partial(daemon.run, HALF_CYCLES), partial(script.run, HALF_CYCLES)),
        COLD_TICK: (partial(daemon.run, COLD, flush), partial(script.run, COLD, flush)),
        SLOW_STEP: (slow_steps(), updates()),
        LOG_ROW: (
            partial(per_row, partial(packed_ticks, reports)),
            partial(per_row, partial(as_csv, reports)),
        ),
    }
    return {name: take_turns(turns, *pair) for name, pair in pairs.items()}


if __name__ == "__main__":
    found = main(int(sys.argv[1]))
    sys.stdout.write(json.dumps({name: list(map(asdict, one)) for name, one in found.items()}))
