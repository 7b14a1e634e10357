"""The kinds of `[bus]`, and the checks of each kind against the rest of the configuration."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, get_args

from adaptdrive.config.bus import BusSection, CanBus
from adaptdrive.config.cadence import clock_flaws, poll_flaws, sync_flaws
from adaptdrive.config.canopen import CanOpenBus, canopen_flaws
from adaptdrive.config.modbus import ModbusRtu, ModbusTcp
from adaptdrive.config.references import modbus_flaws
from adaptdrive.config.scpi import ScpiBus, scpi_flaws
from adaptdrive.errors import Flaw

Check = Callable[[Any, Any], Iterator[Flaw]]
"""Yields what is wrong; takes the `[bus]` section and what it is compared with."""

AnyBus = CanBus | CanOpenBus | ModbusTcp | ModbusRtu | ScpiBus

BUS_TYPES: tuple[str, ...] = tuple(
    name for kind in get_args(AnyBus) for name in get_args(kind.model_fields["type"].annotation)
)


def no_flaws(*_: object) -> Iterator[Flaw]:
    """Yield nothing: the names of the signals are compared with the database of the bus."""
    return iter(())


_MODBUS = (modbus_flaws, poll_flaws)
BUS_CHECKS: Mapping[type[BusSection], tuple[Check, Check]] = {
    CanBus: (no_flaws, clock_flaws),
    CanOpenBus: (canopen_flaws, sync_flaws),
    ModbusTcp: _MODBUS,
    ModbusRtu: _MODBUS,
    ScpiBus: (scpi_flaws, lambda bus, rest: poll_flaws(bus.as_registers(), rest)),
}
"""Checks of each kind of `[bus]`: against `[signals]`, and of its pace against all sections."""
