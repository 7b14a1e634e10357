"""The simulated drive as a device on Modbus: a TCP server, or an RTU device on a serial port.

It shows its registers as they were at the end of the last half cycle. A write to the command is
obeyed when every value is in range and, where the map has one, the daemon's heartbeat has advanced;
otherwise it is answered with an exception, or ignored and counted.
"""

from __future__ import annotations

import collections
import time
from collections.abc import Callable, Mapping

from pymodbus.constants import ExcCodes

from adaptdrive.config.bus import Signals
from adaptdrive.config.polled import ModbusRtu, ModbusTcp
from adaptdrive.devices.modbus.link import describe_bus
from adaptdrive_sim.devices.drive import Frame, Report, SimulatedDrive
from adaptdrive_sim.devices.frames import quantities_of
from adaptdrive_sim.devices.modbus_server import serving
from adaptdrive_sim.devices.pacing import run_half_cycles
from adaptdrive_sim.devices.registers import RegisterImage, Table


class ModbusDrive:
    """One simulated drive on one link.

    Attributes:
        counts: Requests answered, commands obeyed and refused, by name.
    """

    def __init__(
        self,
        drive: SimulatedDrive,
        config: ModbusTcp | ModbusRtu,
        signals: Signals,
        report: Report,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counts: collections.Counter[str] = collections.Counter()
        self._drive = drive
        self._config = config
        self._report = report
        self._clock = clock
        self._image = RegisterImage(config, signals)
        self._heartbeat: tuple[int, ...] | None = None

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the link, pass its description to `opened`, and serve it until cancelled.

        Raises:
            BusError: The link cannot be opened.
        """
        async with serving(self._config, {self._config.device_id: self}):
            opened(describe_bus(self._config))
            await run_half_cycles(self._drive, self._clock, self.show, self._report)

    def show(self, frame: Frame) -> None:
        """Put a half cycle into the registers."""
        self._image.show(quantities_of(frame))

    def read(self) -> Mapping[str, Table]:
        """Both tables as they were at the end of the last half cycle."""
        self.counts["requests"] += 1
        return self._image.tables

    def write(self, address: int, words: list[int]) -> ExcCodes | None:
        """Obey a write that is whole, in range and alive."""
        image = self._image
        holding = {**image.tables["holding"]}
        holding |= {address + number: word for number, word in enumerate(words)}
        command = image.command({**image.tables, "holding": holding})
        if command is None:
            self._refuse("out_of_range")
            return ExcCodes.ILLEGAL_VALUE
        image.tables["holding"] = holding
        heartbeat = image.heartbeat(image.tables)
        if heartbeat is not None and heartbeat == self._heartbeat:
            self._refuse("counter_stuck")
            return None
        self._heartbeat = heartbeat
        self.counts["obeyed"] += 1
        self._drive.hold(command.boost_reference_V, command.bridge, self._clock())
        return None

    def _refuse(self, reason: str) -> None:
        """Count a refusal, and report the first of its kind: a flood must not fill the log."""
        self.counts[reason] += 1
        if self.counts[reason] == 1:
            self._report("command refused", reason=reason)
