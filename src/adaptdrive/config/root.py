"""The whole configuration of one drive."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from operator import attrgetter
from typing import Annotated

from pydantic import Field

from adaptdrive.config.bus import CanBus, CanOpenBus, Signals
from adaptdrive.config.drive import DriveSection, VoltageLoop
from adaptdrive.config.load import (
    AnyLoad,
    Estimator,
    MotorSection,
    SimulatorSection,
    Supervisor,
)
from adaptdrive.config.polled import ModbusRtu, ModbusTcp, ScpiBus
from adaptdrive.config.references import pace_flaws, reference_flaws
from adaptdrive.config.section import Section, misfit
from adaptdrive.config.sensors import AnySensorBus
from adaptdrive.config.services import InterlocksSection, Mqtt, Realtime, Recording
from adaptdrive.config.supply import Derived, link_flaws, needed_names, supply_flaws, voltage_flaws
from adaptdrive.config.timing import Timing
from adaptdrive.util.errors import Flaw

AnyBus = CanBus | CanOpenBus | ModbusTcp | ModbusRtu | ScpiBus

SensorBus = Annotated[AnySensorBus, Field(discriminator="type")]


class Configuration(Section):
    """One TOML file, one drive; `consistency_flaws` compares the sections with each other."""

    drive: DriveSection
    bus: AnyBus = Field(discriminator="type")
    signals: Signals
    sensor_bus: list[SensorBus] = Field(default=[])
    derived: dict[str, Derived] = Field(default={})
    voltage_loop: VoltageLoop = Field(default_factory=VoltageLoop)
    load: AnyLoad = Field(discriminator="type")
    estimator: Estimator = Field(default_factory=Estimator)
    supervisor: Supervisor = Field(default_factory=Supervisor)
    interlocks: InterlocksSection
    mqtt: Mqtt = Field(default_factory=Mqtt)
    recording: Recording = Field(default_factory=Recording)
    realtime: Realtime = Field(default_factory=Realtime)
    simulation: SimulatorSection = Field(default_factory=SimulatorSection)

    @property
    def ticks_per_period(self) -> int:
        """Q: fast ticks in one slow period."""
        return round(2 * self.drive.line_frequency_Hz * self.load.period_s)

    @property
    def timing(self) -> Timing:
        """The times of the drive, of which each limit of its obedience is made."""
        in_daemon = self.voltage_loop.where == "daemon"
        voltage = ("boost_voltage_V",) if in_daemon else ()
        return Timing(
            half_cycle_s=self.drive.half_cycle_s,
            stale_s=self.interlocks.stale_s,
            ticks_per_reading=self.bus.ticks_per_reading,
            start_s=self.interlocks.start_s,
            stop_s=self.interlocks.stop_s,
            command_timeout_s=self.bus.command_timeout_s,
            voltage_parts=frozenset(needed_names(self.derived, voltage)),
        )


def _rate_flaws(whole: Configuration) -> Iterator[Flaw]:
    load, ticks = whole.load, whole.ticks_per_period
    half_cycle_s = whole.drive.half_cycle_s
    if ticks < 1 or not math.isclose(load.period_s, ticks * half_cycle_s, rel_tol=1e-6):
        rule = f"must be a whole number of half cycles of {half_cycle_s:.6g} s"
        yield Flaw("load.period_s", f"{load.period_s} {rule}")
    period = f"the {ticks} ticks of one period"
    if load.samples > ticks:
        yield Flaw("load.samples", f"{load.samples} exceeds {period}")
    yield from misfit("load.latency_ticks", load.latency_ticks, "below", ticks, period)


def _command_flaws(whole: Configuration) -> Iterator[Flaw]:
    where = whole.voltage_loop.where
    needed = ["current_scale_S" if where == "daemon" else "boost_reference_V"]
    one_bit = whole.drive.enable_bit == "bridge-and-boost"
    if not (whole.bus.has_bridge_words or (where == "drive" and one_bit)):
        needed.append("bridge")
    for name in needed:
        why = f"voltage_loop.where = {where!r} needs it"
        if name == "bridge" and where == "drive":
            why = "nothing would switch the drive off; a drive that a set-point of 0 stops needs "
            why += "drive.enable_bit = 'bridge-and-boost'"
        if getattr(whole.signals.command, name) is None:
            yield Flaw(f"signals.command.{name}", f"is missing: {why}")


def _lowest_flaws(whole: Configuration) -> Iterator[Flaw]:
    """The lowest V_c is one that the stage can make, and the load bears."""
    unit = whole.drive.manipulated.unit
    if whole.voltage_loop.where == "daemon" and unit != "V":
        yield Flaw("drive.manipulated.unit", f"{unit!r} needs voltage_loop.where = 'drive'")
    drive, lowest_V = whole.drive, whole.drive.limits.boost_reference_min_V
    place = "drive.limits.boost_reference_min_V"
    peak = drive.line_voltage_V * 2**0.5
    if whole.voltage_loop.where == "daemon" and lowest_V <= peak:
        yield Flaw(place, f"{lowest_V} must be above the line's peak of {peak:.1f} V")
    elif lowest_V < 0.0 and whole.load.type != "motor":
        kind = whole.load.type
        yield Flaw(place, f"{lowest_V} must not be below 0: a {kind} has no direction")


def _lag_flaws(whole: Configuration) -> Iterator[Flaw]:
    lag_s, period_s = whole.voltage_loop.lag_s, whole.load.period_s
    if lag_s is None:
        return
    if whole.voltage_loop.where == "daemon":
        problem = "is for where = 'drive': the delay of the daemon's own loop is known"
        yield Flaw("voltage_loop.lag_s", problem)
    else:
        longest = f"load.period_s = {period_s} s: choose a longer period"
        yield from misfit("voltage_loop.lag_s", lag_s, "at most", period_s, longest)
    impulse = isinstance(whole.load, MotorSection) and whole.load.boost_course == "impulse"
    if impulse and lag_s > 0.25 * period_s:
        yield Flaw("load.boost_course", f"'impulse' needs voltage_loop.lag_s = {lag_s} s shorter")


def _trip_flaws(whole: Configuration) -> Iterator[Flaw]:
    for place, relation, limit in (
        ("interlocks.boost_voltage_max_V", "above", "drive.limits.boost_reference_max_V"),
        ("interlocks.output_max", "above", "load.reference_max"),
        ("interlocks.output_min", "below", "load.reference_min"),
    ):
        trip, highest = attrgetter(place)(whole), attrgetter(limit)(whole)
        if trip is not None:
            yield from misfit(place, trip, relation, highest, f"{limit} = {highest}")


_CHECKS: dict[Callable[[Configuration], Iterator[Flaw]], str] = {
    _rate_flaws: "drive load",
    reference_flaws: "bus signals",
    link_flaws: "bus sensor_bus",
    pace_flaws: "drive bus signals load interlocks voltage_loop",
    supply_flaws: "drive bus signals sensor_bus derived load voltage_loop",
    _lowest_flaws: "drive voltage_loop load",
    voltage_flaws: "drive voltage_loop interlocks sensor_bus derived",
    _command_flaws: "bus signals voltage_loop drive",
    _lag_flaws: "voltage_loop load",
    _trip_flaws: "drive load interlocks",
}
"""Checks between sections, and the sections that each one reads."""


def consistency_flaws(configuration: Configuration, valid: Collection[str]) -> Iterator[Flaw]:
    """Find what contradicts each other between sections.

    Args:
        configuration: The sections.
        valid: Names of those that are there; checks of others are left out.
    """
    for check, needed in _CHECKS.items():
        if set(needed.split()).issubset(valid):
            yield from check(configuration)
