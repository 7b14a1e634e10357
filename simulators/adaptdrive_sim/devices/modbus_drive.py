"""The simulated drive as a device on Modbus: a TCP server, or an RTU device on a serial port.

It shows its registers as they were at the end of the last half cycle. A write to the command is
obeyed when every value is in range and, where the map has one, the daemon's heartbeat has advanced;
otherwise it is answered with an exception, or ignored and counted.
"""

from __future__ import annotations

import collections
import contextlib
import termios
import time
from collections.abc import AsyncIterator, Callable

from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from adaptdrive.config.bus import Signals
from adaptdrive.config.modbus import ModbusRtu, ModbusTcp
from adaptdrive.errors import BusError
from adaptdrive.hardware.modbus.bus import describe_bus
from adaptdrive_sim.devices.drive import Drive, Frame, Report
from adaptdrive_sim.devices.frames import quantities_of
from adaptdrive_sim.devices.pacing import run_half_cycles
from adaptdrive_sim.devices.pty_cable import pty_cable
from adaptdrive_sim.devices.registers import RegisterImage

_TABLES = {3: "holding", 4: "input", 6: "holding", 16: "holding", 22: "holding", 23: "holding"}


class ModbusDrive:
    """One simulated drive on one link.

    Attributes:
        counts: Requests answered, commands obeyed and refused, by name.
    """

    def __init__(
        self,
        drive: Drive,
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
        """Open the link, tell `opened` which one it is, and serve it until cancelled.

        Raises:
            BusError: The link cannot be opened.
        """
        async with self._serving():
            opened(describe_bus(self._config))
            await run_half_cycles(self._drive, self._clock, self._show, self._report)

    def _show(self, frame: Frame) -> None:
        self._image.show(quantities_of(frame))

    @contextlib.asynccontextmanager
    async def _serving(self) -> AsyncIterator[None]:
        with contextlib.ExitStack() as stack:
            server = self._server(stack)
            try:
                await server.serve_forever(background=True)
            except (OSError, RuntimeError, termios.error) as problem:
                raise BusError(describe_bus(self._config), str(problem)) from problem
            try:
                yield
            finally:
                await server.shutdown()  # type: ignore[no-untyped-call]

    def _server(self, stack: contextlib.ExitStack) -> ModbusTcpServer | ModbusSerialServer:
        config, device = self._config, self._device()
        if isinstance(config, ModbusTcp):
            return ModbusTcpServer(device, address=(config.host, config.port))
        port = config.device
        if not port.exists():
            port = stack.enter_context(pty_cable(config.device))
        return ModbusSerialServer(
            device,
            framer=FramerType.RTU,
            port=str(port),
            baudrate=config.baud,
            parity=config.parity[0].upper(),
            stopbits=config.stop_bits,
            ignore_missing_devices=True,
        )

    def _device(self) -> SimDevice:
        """The drive as pymodbus serves it: its registers are fetched at each request."""
        none = [SimData(0, count=16, values=False, datatype=DataType.BITS)]
        registers = {name: self._block(name) for name in ("holding", "input")}
        return SimDevice(
            self._config.device_id,
            (none, none, registers["holding"], registers["input"]),
            action=self._access,
        )

    def _block(self, table: str) -> list[SimData]:
        addresses = self._image.tables[table] or {0: 0}
        first = min(addresses)
        return [SimData(first, count=len(addresses), datatype=DataType.REGISTERS)]

    async def _access(  # noqa: PLR0913, PLR0917 - the signature is pymodbus's
        self,
        function_code: int,
        start_address: int,
        address: int,
        count: int,
        current_registers: list[int],
        set_values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """One request: fetch the registers, or take what is written."""
        table = _TABLES.get(function_code)
        if table is None or not self._image.tables[table]:
            return ExcCodes.ILLEGAL_FUNCTION
        self.counts["requests"] += 1
        if set_values is not None:
            return self._take(address, [int(value) for value in set_values])
        for number in range(address, address + count):
            current_registers[number - start_address] = self._image.tables[table][number]
        return None

    def _take(self, address: int, words: list[int]) -> ExcCodes | None:
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
