"""The kinds of `[bus]`, and the checks of each kind against the rest of the configuration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, get_args

from adaptdrive.config.bus import BusSection, CanBus, Signals
from adaptdrive.config.cadence import Sections, clock_flaws, poll_flaws, sync_flaws
from adaptdrive.config.canopen import CanOpenBus, canopen_flaws
from adaptdrive.config.modbus import ModbusRtu, ModbusTcp
from adaptdrive.config.references import can_flaws, modbus_flaws
from adaptdrive.errors import Flaw

AnyBus = CanBus | CanOpenBus | ModbusTcp | ModbusRtu

BUS_TYPES: tuple[str, ...] = tuple(
    name for kind in get_args(AnyBus) for name in get_args(kind.model_fields["type"].annotation)
)


def _nothing(*_: object) -> Iterator[Flaw]:
    return iter(())


@dataclass(frozen=True, slots=True)
class BusChecks:
    """The checks of one kind of bus; each takes the `[bus]` section first.

    Attributes:
        signals: Of bus and signals.
        pace: Of the time between two readings, against the other sections.
    """

    signals: Callable[[Any, Signals], Iterator[Flaw]]
    pace: Callable[[Any, Sections], Iterator[Flaw]] = _nothing


_MODBUS = BusChecks(modbus_flaws, poll_flaws)
_CHECKS: dict[type[BusSection], BusChecks] = {
    CanBus: BusChecks(can_flaws, clock_flaws),
    CanOpenBus: BusChecks(canopen_flaws, sync_flaws),
    ModbusTcp: _MODBUS,
    ModbusRtu: _MODBUS,
}


def bus_checks(bus: AnyBus) -> BusChecks:
    """Return the checks of the kind that a `[bus]` section is of."""
    return _CHECKS[type(bus)]
