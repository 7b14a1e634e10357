"""Each station of a half cycle, from the wake-up to the record of its tick, with warm caches.

CPU time of this thread, the least of many rounds: what other processes do hardly counts.
"""

from __future__ import annotations

import asyncio
import os
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial

from can.interfaces.udp_multicast.utils import pack_message

from adaptdrive.control.signals import Command
from adaptdrive.devices.can import port as can_port
from adaptdrive.devices.can.bus import LoopbackMulticast, parse
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.devices.port import PortStatistics
from adaptdrive.mqtt.contract import Output, drive_message, encode
from adaptdrive.recording.records import packed_ticks
from adaptdrive.runtime.accounts import drive_report
from adaptdrive.runtime.fast_loop import TimeWindow
from adaptdrive.runtime.reports import Hub, TickReport
from adaptdrive.runtime.tick_support import IdleCollector, LatencyDetector
from adaptdrive.util.clock import arm_timer, create_timer
from tests.unit.devices.bench import EXAMPLES, MOTOR, MOTOR_BUS, TIMING
from tools.benchmarks import compute
from tools.benchmarks.rows import Extent, Row
from tools.benchmarks.tools import GROUP, bus_ports

CALLS, ROUNDS = 100, 40
PER_REPORT = 12
"""Half cycles between two reports at the highest rate of telemetry."""

SLICE = 50
"""Reports that the recorder packs at once."""

Job = Callable[[], object]


def rows(_: Extent) -> Iterator[Row]:
    """All rows of this file; each is the cost of one half cycle."""
    for stations in (_bus(), _wake_up(), _tick(), _books(), _recorder(), _telemetry(), _after()):
        for name, spent_us in stations:
            yield Row(f"half cycle: {name}", spent_us, "us")


def least_us(job: Job, prepare: Job = lambda: None, calls: int = CALLS) -> float:
    """Return the least mean CPU time of a call, in microseconds."""
    times = []
    for _ in range(ROUNDS):
        prepare()
        began_s = time.thread_time()
        for _ in range(calls):
            job()
        times.append((time.thread_time() - began_s) / calls * 1e6)
    return min(times)


def _bus() -> Iterator[tuple[str, float]]:
    """Two status frames in, and one command out."""
    (port,) = bus_ports(1)
    bus, peer = LoopbackMulticast(GROUP, port, fd=False), LoopbackMulticast(GROUP, port, fd=False)
    frame = compute.status_frames(1)[0][0]
    datagram = pack_message(frame)

    def fill() -> None:
        for _ in range(CALLS):
            peer.send(frame)

    received_us = least_us(lambda: bus.recv(0.0), fill)
    parsed_us = least_us(lambda: parse(datagram, 1.0))
    yield "two frames received: system call", 2.0 * (received_us - parsed_us)
    yield "two frames received: python-can's conversion", 2.0 * parsed_us
    bus.shutdown()
    sent_us, packed_us = least_us(lambda: peer.send(frame)), least_us(lambda: pack_message(frame))
    yield "command sent: python-can's conversion", packed_us
    yield "command sent: system call", sent_us - packed_us
    peer.shutdown()


def _wake_up() -> Iterator[tuple[str, float]]:
    """The event loop, which wakes up for each of two frames."""
    loop = asyncio.new_event_loop()
    here, there = socket.socketpair()
    left = 0

    def woken() -> None:
        nonlocal left
        left -= 1
        if left == 0:
            here.recv(1)
            loop.stop()

    def run() -> None:
        nonlocal left
        left = CALLS
        there.send(b"x")
        loop.run_forever()

    loop.add_reader(here.fileno(), woken)
    yield "two wake-ups of the event loop", 2.0 * least_us(run, calls=1) / CALLS
    loop.close()
    here.close()
    there.close()


def _tick() -> Iterator[tuple[str, float]]:
    """Two frames checked and assembled, the tick itself, and the command encoded."""
    bus = compute._Frames()
    now_s = time.monotonic()
    mapping = map_drive(MOTOR_BUS, MOTOR.signals, TIMING, EXAMPLES / "motor.toml")
    port = can_port.Port(MOTOR_BUS, mapping, lambda: now_s)
    port._connection.bus = bus
    frames = iter([one for pair in compute.status_frames(CALLS * ROUNDS) for one in pair])
    yield (
        "two frames checked and assembled",
        2.0 * least_us(lambda: port.take(next(frames)), calls=2 * CALLS),
    )
    command = Command(0.0512, 301.25, True)
    yield "command encoded", least_us(lambda: port.send(command))
    bus.shutdown()
    loop, quiet = compute.running_loop(lambda _: None)
    count = compute.WARM_UP
    reading = replace(compute.CALM)

    def tick() -> None:
        nonlocal count
        compute.feed(loop, quiet, count, bridge=True)
        count += 1

    made_us = least_us(lambda: replace(reading, arrival_s=1.0, oldest_s=1.0, counter=1))
    yield "tick, with its statistics and report", least_us(tick) - made_us


def _report() -> TickReport:
    loop, quiet = compute.running_loop(lambda _: None)
    kept: list[TickReport] = []
    quiet.ticked = kept.append  # type: ignore[method-assign, assignment]
    compute.feed(loop, quiet, compute.WARM_UP, bridge=True)
    return kept[0]


def _books() -> Iterator[tuple[str, float]]:
    """Statistics and report, which are part of the tick, and come after its command."""
    report = _report()
    windows = [TimeWindow() for _ in range(3)]

    def count() -> None:
        for window in windows:
            window.add(12.5)

    yield "of the tick: three times counted", least_us(count)
    found = report.measurement, report.order, report.applied_k, report.command
    yield "of the tick: its report", least_us(lambda: TickReport(1, *found, 1.0, 2.0, 3.0, 4.0))


def _recorder() -> Iterator[tuple[str, float]]:
    """Hand-over to the recorder, one by one and in slices."""
    hub, report = Hub(), _report()
    queue = hub.subscribe(TickReport, size=CALLS)
    yield "tick handed to the recorder", least_us(lambda: hub.publish(report), queue.drain)
    for count in (SLICE, 1):
        spent_us = least_us(partial(packed_ticks, [report] * count), calls=10)
        yield f"tick turned into columns, {count} at once", spent_us / count


def _telemetry() -> Iterator[tuple[str, float]]:
    """A report for the broker: in every half cycle, ten times a second and once a second."""
    loop, quiet = compute.running_loop(lambda _: None)
    number, statistics, now = compute.WARM_UP, PortStatistics(), datetime.now(UTC)
    output = Output("speed", "V")

    def prepare(count: int) -> None:
        nonlocal number
        for _ in range(count):
            compute.feed(loop, quiet, number, bridge=True)
            number += 1

    def publish() -> None:
        encode(drive_message(drive_report(loop, statistics, (), quiet.now), now, output))

    for count in (1, PER_REPORT, 120):
        spent_us = least_us(publish, partial(prepare, count), calls=1) / count
        yield f"telemetry every {count} half cycles: quantiles, message, JSON", spent_us


def _after() -> Iterator[tuple[str, float]]:
    """What is left after the command."""
    timer = create_timer()
    yield "stand-in timer armed", least_us(lambda: arm_timer(timer, time.monotonic() + 1.0))
    detector = LatencyDetector(lambda _: None, time.monotonic)
    collector = IdleCollector()

    def watch() -> None:
        detector.ticked(1.0, 1.0)
        collector.is_due()

    yield "lateness and garbage watched", least_us(watch)
    os.close(timer)
