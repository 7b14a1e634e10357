"""Checks of the time between two readings of a drive against the other sections."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from adaptdrive.config.bus import CanBus, CanOpenBus, CommandWatch
from adaptdrive.config.modbus import ModbusBus
from adaptdrive.config.timing import LATE_READINGS
from adaptdrive.errors import Flaw

if TYPE_CHECKING:
    from adaptdrive.config.root import Configuration

DAY_S = 86400.0


def poll_flaws(bus: ModbusBus, configuration: Configuration) -> Iterator[Flaw]:
    """Yield the contradictions to a drive that is polled.

    Args:
        bus: `[bus]`.
        configuration: The other sections.
    """
    poll_s = bus.poll_ticks * configuration.drive.half_cycle_s
    poll = f"one poll of bus.poll_ticks = {bus.poll_ticks} half cycles"
    if bus.timeout_s >= poll_s:
        given = f"{bus.timeout_s} must be below {poll} ({poll_s * 1e3:.4g} ms)"
        yield Flaw("bus.timeout_s", given)
    yield from _pace_flaws(bus.poll_ticks, configuration, poll)
    if configuration.voltage_loop.where == "daemon":
        yield Flaw(
            "voltage_loop.where",
            "'daemon' needs a drive that sends each half cycle; one that is polled must hold its "
            "own boost voltage: 'drive'",
        )
    elif configuration.signals.command.current_scale_S is not None:
        yield Flaw("signals.command.current_scale_S", "a drive that is polled takes V_c only")
    yield from _write_flaws(bus, configuration)


def _write_flaws(bus: ModbusBus, configuration: Configuration) -> Iterator[Flaw]:
    """Yield why a command that is not written with each poll would not do."""
    timeout_s, interval_s = bus.command_timeout_s, bus.command_interval_s
    if interval_s and bus.read_write:
        yield Flaw("bus.command_interval_s", "bus.read_write writes with each poll: leave it out")
    reading_s = bus.poll_ticks * configuration.drive.half_cycle_s
    most_s = math.inf if timeout_s is None else max(0.0, timeout_s - LATE_READINGS * reading_s)
    if interval_s > most_s:
        longest = f"{most_s:.4g} s, that the drive sees a command in time"
        yield Flaw("bus.command_interval_s", f"{interval_s:g} must be at most {longest}")
    for name, register in bus.registers.items():
        place, limit = f"bus.registers.{name}.write_limit", register.write_limit
        if limit is None:
            continue
        if bus.read_write:
            yield Flaw(place, "bus.read_write writes with each poll: leave it out")
        if timeout_s is not None:
            yield Flaw(place, "bus.command_timeout_s is the time-out of a drive that needs writes")
        period_s, least_s = configuration.load.period_s, DAY_S / limit
        reference = configuration.signals.command.boost_reference_V
        holds_back = configuration.load.traits.charges or configuration.signals.load_power_W
        if holds_back and reference is not None and reference.signal == name:
            why = "delays what holds V_c back for the power of the load or the voltage of a battery"
            yield Flaw(place, why)
        if period_s < least_s:
            longer = f"let load.period_s be {least_s:.4g} s or longer"
            yield Flaw(place, f"{limit} writes a day are one in {least_s:.4g} s: {longer}")


def clock_flaws(bus: CanBus, configuration: Configuration) -> Iterator[Flaw]:
    """Yield the contradictions to a drive that sends less often than each half cycle.

    Args:
        bus: `[bus]`.
        configuration: The other sections.
    """
    stride = bus.clock_ticks
    yield from _pace_flaws(stride, configuration, f"bus.clock_ticks = {stride}")
    if stride == 1:
        return
    if configuration.voltage_loop.where == "daemon":
        problem = "'daemon' needs a drive that sends each half cycle: bus.clock_ticks = 1"
        yield Flaw("voltage_loop.where", problem)
    if configuration.signals.counter is not None:
        yield Flaw("signals.counter", "counts half cycles, which needs bus.clock_ticks = 1")


def sync_flaws(bus: CanOpenBus, configuration: Configuration) -> Iterator[Flaw]:
    """Yield the contradictions to a drive that sends after each SYNC.

    Args:
        bus: `[bus]`.
        configuration: The other sections.
    """
    yield from _pace_flaws(1, configuration, "a half cycle, from one SYNC to the next")
    given_s, lowest_s = bus.command_timeout_s, LATE_READINGS * configuration.drive.half_cycle_s
    if _is_below(given_s, lowest_s):
        lowest = f"bus.heartbeat_s = {bus.heartbeat_s} and {LATE_READINGS} half cycles"
        yield Flaw(
            "bus.heartbeat_timeout_s",
            f"{bus.heartbeat_timeout_s} must be at least {bus.heartbeat_s + lowest_s:.4g} s, "
            f"{lowest}: heartbeats come with commands",
        )


def _is_below(given_s: float, lowest_s: float) -> bool:
    """Return whether a time is too short, by more than rounding."""
    return given_s < lowest_s and not math.isclose(given_s, lowest_s)


def _pace_flaws(stride: int, configuration: Configuration, reading: str) -> Iterator[Flaw]:
    """Yield the times that do not fit a drive that gives a reading every so many ticks."""
    reading_s, load = stride * configuration.drive.half_cycle_s, configuration.load
    lowest_s = LATE_READINGS * reading_s
    lowest = f"{lowest_s:.4g} s, {LATE_READINGS} times {reading} ({reading_s * 1e3:.4g} ms)"
    if _is_below(configuration.interlocks.stale_s, lowest_s):
        given = f"{configuration.interlocks.stale_s} must be at least {lowest}"
        yield Flaw("interlocks.stale_s", given)
    timeout_s = configuration.bus.command_timeout_s
    watched = isinstance(configuration.bus, CommandWatch)
    if watched and timeout_s is not None and _is_below(timeout_s, lowest_s):
        given = f"{timeout_s} must be at least {lowest}"
        why = "the drive would stop between two commands"
        yield Flaw("bus.command_timeout_s", f"{given}: {why}")
    for name, ticks, multiple in (
        ("latency_ticks", load.latency_ticks, "a multiple"),
        ("period_s", configuration.ticks_per_period, "a whole multiple"),
    ):
        if ticks % stride:
            wanted = f"its {ticks} ticks must be {multiple} of {reading}"
            yield Flaw(f"load.{name}", f"{wanted}: a decision reaches the drive with a command")
