"""Checks of the time between two readings of a drive against the other sections."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from adaptdrive.config.bus import CanBus, CanOpenBus, PolledBus
from adaptdrive.config.modbus import ModbusBus
from adaptdrive.config.section import misfit
from adaptdrive.config.timing import LATE_READINGS
from adaptdrive.errors import Flaw

if TYPE_CHECKING:
    from adaptdrive.config.root import Configuration

DAY_S = 86400.0


def pace_flaws(whole: Configuration) -> Iterator[Flaw]:
    """Yield what does not fit a drive that gives a reading every so many half cycles.

    Args:
        whole: The configuration.
    """
    bus, stride = whole.bus, whole.bus.ticks_per_reading
    reading_s = stride * whole.drive.half_cycle_s
    late_s = LATE_READINGS * reading_s
    if isinstance(bus, PolledBus):
        reading = f"one poll of bus.poll_ticks = {stride} half cycles"
        poll = f"{reading} ({reading_s * 1e3:.4g} ms)"
        yield from misfit("bus.timeout_s", bus.timeout_s, "below", reading_s, poll)
    elif isinstance(bus, CanBus):
        reading = f"bus.clock_ticks = {stride}"
    else:
        reading = "a half cycle, from one SYNC to the next"
        yield from _heartbeat_flaws(bus, late_s)
    latest = f"{late_s:.4g} s, {LATE_READINGS} times {reading} ({reading_s * 1e3:.4g} ms)"
    yield from misfit("interlocks.stale_s", whole.interlocks.stale_s, "at least", late_s, latest)
    if not isinstance(bus, CanOpenBus) and bus.command_timeout_s is not None:
        stops = f"{latest}: the drive would stop between two commands"
        yield from misfit("bus.command_timeout_s", bus.command_timeout_s, "at least", late_s, stops)
    yield from _loop_flaws(whole, reading)
    if isinstance(bus, ModbusBus):
        yield from _write_flaws(bus, whole, late_s)


def _heartbeat_flaws(bus: CanOpenBus, late_s: float) -> Iterator[Flaw]:
    """The heartbeat after a lost one, and after a command that is late, comes in time."""
    least_s = bus.heartbeat_s + max(bus.heartbeat_s, late_s)
    rule = f"at least 2 times bus.heartbeat_s = {bus.heartbeat_s}, and {LATE_READINGS} half cycles"
    told = f"{least_s:.4g} s, {rule} more than it: heartbeats come with commands"
    yield from misfit("bus.heartbeat_timeout_s", bus.heartbeat_timeout_s, "at least", least_s, told)


def _loop_flaws(whole: Configuration, reading: str) -> Iterator[Flaw]:
    """The loops of the daemon act with the readings of the drive."""
    stride, signals, load = whole.bus.ticks_per_reading, whole.signals, whole.load
    polled = isinstance(whole.bus, PolledBus)
    if whole.voltage_loop.where == "daemon":
        if polled or stride > 1:
            seldom = f"one with {reading} must hold its own boost voltage: 'drive'"
            needed = f"'daemon' needs a drive that sends each half cycle; {seldom}"
            yield Flaw("voltage_loop.where", needed)
    elif polled and signals.command.current_scale_S is not None:
        yield Flaw("signals.command.current_scale_S", "a drive that is polled takes V_c only")
    if stride > 1 and isinstance(whole.bus, CanBus) and signals.counter is not None:
        yield Flaw("signals.counter", "counts half cycles, which needs bus.clock_ticks = 1")
    for name, ticks, multiple in (
        ("latency_ticks", load.latency_ticks, "a multiple"),
        ("period_s", whole.ticks_per_period, "a whole multiple"),
    ):
        if ticks % stride:
            wanted = f"its {ticks} ticks must be {multiple} of {reading}"
            yield Flaw(f"load.{name}", f"{wanted}: a decision reaches the drive with a command")


def _write_flaws(bus: ModbusBus, whole: Configuration, late_s: float) -> Iterator[Flaw]:
    """Yield why a command that is not written with each poll would not do."""
    place, interval_s = "bus.command_interval_s", bus.command_interval_s
    longest_s = max(0.0, (bus.command_timeout_s or math.inf) - late_s)
    in_time = f"{longest_s:.4g} s, that the drive sees a command in time"
    yield from misfit(place, interval_s, "at most", longest_s, in_time)
    places = [place] if interval_s else []
    for name, register in bus.registers.items():
        if register.write_limit is not None:
            places.append(f"bus.registers.{name}.write_limit")
            yield from _limit_flaws(places[-1], name, register.write_limit, whole)
    if bus.read_write:
        problem = "bus.read_write writes with each poll: leave it out"
        yield from (Flaw(place, problem) for place in places)


def _limit_flaws(place: str, name: str, limit: int, whole: Configuration) -> Iterator[Flaw]:
    """Yield why a register that wears out is written too often, or too late."""
    if whole.bus.command_timeout_s is not None:
        yield Flaw(place, "bus.command_timeout_s is the time-out of a drive that needs writes")
    reference = whole.signals.command.boost_reference_V
    holds_back = whole.load.traits.charges or whole.signals.load_power_W
    if holds_back and reference is not None and reference.signal == name:
        why = "delays what holds V_c back for the power of the load or the voltage of a battery"
        yield Flaw(place, why)
    least_s = DAY_S / limit
    if whole.load.period_s < least_s:
        longer = f"let load.period_s be {least_s:.4g} s or longer"
        yield Flaw(place, f"{limit} writes a day are one in {least_s:.4g} s: {longer}")
