"""Port of a drive on Modbus."""

from __future__ import annotations

from collections.abc import Callable

from adaptdrive.config.modbus import ModbusRtu, ModbusTcp, RtuLink
from adaptdrive.config.timing import Timing
from adaptdrive.hardware.modbus.frames import are_alike
from adaptdrive.hardware.modbus.link import ModbusConnection, describe_bus
from adaptdrive.hardware.modbus.serial_port import SerialPort
from adaptdrive.hardware.polled.capacity import Exchange
from adaptdrive.hardware.polled.link import PolledLink
from adaptdrive.hardware.polled.mapping import Poll
from adaptdrive.hardware.polled.port import PolledPort


class ModbusPort(PolledPort):
    """One connection to one drive on Modbus."""

    def __init__(
        self, config: ModbusTcp | ModbusRtu, poll: Poll, timing: Timing, clock: Callable[[], float]
    ) -> None:
        super().__init__(describe_bus(config), config, poll, timing, clock)
        self._config = config
        self._serial = SerialPort(config) if isinstance(config, RtuLink) else None
        self.must_open = self._serial is not None
        joined = [one for one in poll.exchanges() if one.read is not None]
        apart = [Exchange(read=block) for block, _ in poll.bridge_last]
        self._alike = any(are_alike(config, reads) for reads in (joined, apart))

    def _new_link(self) -> PolledLink:
        return ModbusConnection(self._config, self._counts, self._clock, serial=self._serial)
