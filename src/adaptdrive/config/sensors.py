"""`[[sensor_bus]]`: sensors on other buses than the drive, each with its cycle time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from adaptdrive.config.bus import CanDescription, Quantity
from adaptdrive.config.modbus import ModbusLink, Register, RtuLink, TcpLink
from adaptdrive.config.references import map_flaws, unknown_flaws
from adaptdrive.config.section import PositiveFloat, Section, key, misfit
from adaptdrive.errors import Flaw

if TYPE_CHECKING:
    from adaptdrive.config.root import Configuration

STALE_CYCLES = 1.5
"""Cycles that a value must be allowed to age: it is one old when the next one comes."""

DEFAULT_STALE_CYCLES = 3.0
"""Cycles that a value may age by default: two replies in a row may be lost."""


MOST_STALE_CYCLES = 10.0
"""Cycles after which a value is old: ten replies in a row are not lost by chance."""

LONGEST_STALE_S = 10.0
"""Age at which a value is old however seldom it comes, but for the two cycles that may be lost."""


class SensorRegister(Register):
    """`[sensor_bus.registers.NAME]`: one value of a module's register map."""

    device_id: int | None = key(None, span=(1, 255))


class SensorBusSection(Section):
    """Keys of `[[sensor_bus]]` for every kind of bus."""

    name: str = Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]{0,63}$")
    cycle_s: PositiveFloat = Field(ge=1e-3)
    stale_s: PositiveFloat | None = None
    signals: dict[str, Quantity]

    @property
    def oldest_s(self) -> float:
        """The oldest usable value."""
        return DEFAULT_STALE_CYCLES * self.cycle_s if self.stale_s is None else self.stale_s


class ModbusSensorSection(SensorBusSection, ModbusLink):
    """Keys of `[[sensor_bus]]` for every kind of Modbus."""

    registers: dict[str, SensorRegister] = key({})


class ModbusTcpSensors(ModbusSensorSection, TcpLink):
    """`[[sensor_bus]]` with `type = "modbus-tcp"`."""

    type: Literal["modbus-tcp"]


class ModbusRtuSensors(ModbusSensorSection, RtuLink):
    """`[[sensor_bus]]` with `type = "modbus-rtu"`."""

    type: Literal["modbus-rtu"]


class CanSensorSection(SensorBusSection, CanDescription):
    """`[[sensor_bus]]` with `type = "can"`: sensors that send by themselves."""

    type: Literal["can"]


AnySensorBus = CanSensorSection | ModbusTcpSensors | ModbusRtuSensors


def sensor_flaws(whole: Configuration) -> Iterator[Flaw]:
    """Yield the errors in each sensor bus by itself.

    Args:
        whole: The configuration.
    """
    for number, bus in enumerate(whole.sensor_bus):
        place = f"sensor_bus.{number}"
        yield from _age_flaws(bus, place)
        if not isinstance(bus, CanSensorSection):
            yield from _modbus_flaws(bus, place)


def _age_flaws(bus: AnySensorBus, place: str) -> Iterator[Flaw]:
    lowest_s = STALE_CYCLES * bus.cycle_s
    lowest = f"{lowest_s:.4g} s, {STALE_CYCLES} times cycle_s"
    yield from misfit(f"{place}.stale_s", bus.oldest_s, "at least", lowest_s, lowest)
    highest_s = min(
        MOST_STALE_CYCLES * bus.cycle_s, max(LONGEST_STALE_S, DEFAULT_STALE_CYCLES * bus.cycle_s)
    )
    if bus.oldest_s > highest_s:
        yield Flaw(
            f"{place}.stale_s",
            f"{bus.stale_s} must not exceed {highest_s:.4g} s: {MOST_STALE_CYCLES:g} times "
            f"cycle_s, and {LONGEST_STALE_S:g} s or {DEFAULT_STALE_CYCLES:g} times cycle_s",
        )


def _modbus_flaws(bus: ModbusSensorSection, place: str) -> Iterator[Flaw]:
    for device in {register.device_id for register in bus.registers.values()}:
        registers = {name: one for name, one in bus.registers.items() if one.device_id == device}
        yield from map_flaws(f"{place}.registers", registers, zero_based=bus.zero_based)
    named = [(f"{place}.signals.{name}.signal", one.signal) for name, one in bus.signals.items()]
    yield from unknown_flaws(named, bus.registers, "[sensor_bus.registers] has no register")
    cycle = f"cycle_s = {bus.cycle_s}"
    yield from misfit(f"{place}.timeout_s", bus.timeout_s, "below", bus.cycle_s, cycle)
