"""`[[sensor_bus]]`: sensors on other buses than the drive, each with its cycle time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from adaptdrive.config.bus import CanDescription, Quantity
from adaptdrive.config.polled import ModbusLink, Register, RtuLink, TcpLink
from adaptdrive.config.references import map_flaws, unknown_flaws
from adaptdrive.config.section import PositiveFloat, Section, key, misfit
from adaptdrive.util.errors import Flaw

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

    def flaws(self) -> Iterator[Flaw]:
        """Yield an age that is too low, or too high."""
        yield from super().flaws()
        cycle_s, oldest_s = self.cycle_s, self.oldest_s
        lowest = f"{STALE_CYCLES * cycle_s:.4g} s, {STALE_CYCLES} times cycle_s"
        yield from misfit("stale_s", oldest_s, "at least", STALE_CYCLES * cycle_s, lowest)
        rare_s = max(LONGEST_STALE_S, DEFAULT_STALE_CYCLES * cycle_s)
        highest_s = min(MOST_STALE_CYCLES * cycle_s, rare_s)
        if oldest_s > highest_s:
            limits = f"{MOST_STALE_CYCLES:g} times cycle_s, and {LONGEST_STALE_S:g} s or"
            problem = f"{self.stale_s} must not exceed {highest_s:.4g} s: {limits}"
            yield Flaw("stale_s", f"{problem} {DEFAULT_STALE_CYCLES:g} times cycle_s")


class ModbusSensorSection(SensorBusSection, ModbusLink):
    """Keys of `[[sensor_bus]]` for every kind of Modbus."""

    registers: dict[str, SensorRegister] = key({})

    def flaws(self) -> Iterator[Flaw]:
        """Yield what is wrong in the register maps, and with names in them."""
        yield from super().flaws()
        for device in {register.device_id for register in self.registers.values()}:
            registers = {
                name: one for name, one in self.registers.items() if one.device_id == device
            }
            yield from map_flaws("registers", registers, zero_based=self.zero_based)
        named = [(f"signals.{name}.signal", one.signal) for name, one in self.signals.items()]
        yield from unknown_flaws(named, self.registers, "[sensor_bus.registers] has no register")


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
