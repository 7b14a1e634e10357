"""A drive on Modbus: its port, and how the daemon builds it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.bus import Signals
from adaptdrive.config.modbus import ModbusRtu, ModbusTcp, RtuLink
from adaptdrive.config.timing import LATE_READINGS, Timing
from adaptdrive.errors import Flaw
from adaptdrive.hardware.bus_kind import BusKind, polled_cautions, tcp_locks
from adaptdrive.hardware.modbus.frames import are_alike
from adaptdrive.hardware.modbus.link import ModbusConnection, describe_bus, miss_s
from adaptdrive.hardware.modbus.sensors import build_modbus_sensors
from adaptdrive.hardware.modbus.serial_port import SerialPort
from adaptdrive.hardware.polled.capacity import Exchange
from adaptdrive.hardware.polled.link import PolledLink
from adaptdrive.hardware.polled.mapping import Poll, planned
from adaptdrive.hardware.polled.port import PolledPort
from adaptdrive.hardware.port import Port

_LOST_REPLIES = 2
"""Replies in a row that may be lost on a drive that runs."""


class ModbusPort(PolledPort):
    """One connection to one drive on Modbus."""

    def __init__(
        self, config: ModbusTcp | ModbusRtu, poll: Poll, timing: Timing, clock: Callable[[], float]
    ) -> None:
        super().__init__(describe_bus(config), config, poll, timing, clock)
        self._config = config
        self._serial = SerialPort(config) if isinstance(config, RtuLink) else None
        self.must_open = self._serial is not None
        self._alike = are_alike(config, [Exchange(read=block) for block, _ in poll.reads])

    def _new_link(self) -> PolledLink:
        return ModbusConnection(self._config, self._counts, self._clock, serial=self._serial)


def _build(
    configuration: Configuration, clock: Callable[[], float], source: Path | str, passive: bool
) -> Port:
    bus = _bus(configuration)
    poll = planned(configuration, bus, source, passive=passive)
    return ModbusPort(bus, poll, configuration.timing, clock)


def _cautions(configuration: Configuration) -> Iterator[Flaw]:
    """Yield what time-outs and lost replies do not fit, and a report that may be an echo."""
    yield from polled_cautions(configuration)
    yield from _loss_cautions(_bus(configuration), configuration.timing)
    yield from _echo_cautions(_bus(configuration), configuration.signals)


def _loss_cautions(bus: ModbusTcp | ModbusRtu, timing: Timing) -> Iterator[Flaw]:
    """Yield one word on a drive that trips as soon as few replies are lost or late."""
    least_s = LATE_READINGS * timing.reading_s + _LOST_REPLIES * miss_s(bus)
    if timing.stale_s < least_s and not math.isclose(timing.stale_s, least_s):
        text = f"{timing.stale_s:g} s is shorter than {least_s:.4g} s, {LATE_READINGS:g} polls and"
        lost = f"the {_LOST_REPLIES * miss_s(bus):.4g} s of {_LOST_REPLIES} lost replies"
        yield Flaw("interlocks.stale_s", f"{text} {lost} (bus.timeout_s): they trip it")


def _echo_cautions(bus: ModbusTcp | ModbusRtu, signals: Signals) -> Iterator[Flaw]:
    """Yield one word on a report of the bridge in the register of its command."""
    report, command = signals.bridge, signals.command.bridge
    if report is None or command is None:
        return
    read, written = bus.registers[report.signal], bus.registers[command.signal]
    same = read.table == written.table or (read.table, written.table) == ("discrete", "coil")
    if not same or read.address != written.address:
        return
    yield Flaw(
        "signals.bridge",
        f"{report.signal!r} lies in the register of signals.command.bridge: where the drive only "
        "keeps there what was written, each stop is confirmed, of a drive that does not obey too; "
        "name a register that follows the power stage, or see with the drive in local mode that "
        "the register does not follow the command",
    )


def _lock_names(configuration: Configuration) -> Iterator[str]:
    """Yield a device over TCP, by its addresses, too; a serial line is locked as a whole."""
    bus = _bus(configuration)
    if isinstance(bus, ModbusTcp):
        yield describe_bus(bus)
        yield from tcp_locks("modbus-tcp", bus.host, bus.port, f" device {bus.device_id}")


def _bus(configuration: Configuration) -> ModbusTcp | ModbusRtu:
    assert isinstance(configuration.bus, ModbusTcp | ModbusRtu)  # noqa: S101 - selected by its type
    return configuration.bus


MODBUS = BusKind(_build, _cautions, build_modbus_sensors, lock_names=_lock_names)
