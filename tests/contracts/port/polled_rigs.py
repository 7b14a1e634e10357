"""Rigs in memory: a drive on Modbus TCP, and a supply that speaks SCPI."""

from __future__ import annotations

import asyncio
import tomllib
from pathlib import Path

from adaptdrive.app.ports import build_port
from adaptdrive.config.file import validate_configuration
from tests.contracts.port.rig import Rig
from tests.unit.devices import memory
from tests.unit.devices.bench import Ear
from tests.unit.devices.modbus.bench import Peer, POLL_s, build
from tests.unit.devices.scpi.test_port import EXAMPLE, Supply

_ON, _FAULT, _NO_VALUE = 1, 2, 0xFFFF
_BITS: dict[str, str | None] = {
    "bus__registers__on": "{ address = 5, table = 'input', mask = 0x1 }",
    "bus__registers__fault": "{ address = 5, table = 'input', mask = 0x2 }",
    "signals__bridge": '"on"',
    "signals__fault": '"fault"',
}


class _Drive(Peer):
    """A drive that tells a rig what it hears, and reports what the rig wants."""

    rig: ModbusRig
    beat = 0

    def reply(self, request: bytes) -> bytes:
        self.dead = {1} if self.rig.silent else set()
        if self.rig.refuses and request[0] == 16:
            return bytes((request[0] | 0x80, 6))
        return super().reply(request)

    def _write(self, head: bytes, data: bytes) -> None:
        super()._write(head, data)
        volts, on, beat = self.writes[-1][1]
        if beat != self.beat:
            self.rig.feed()
        self.beat = beat
        self.rig.hear(bridge=on == 1, voltage_V=0.01 * volts)

    def _registers(self, function: int, address: int, count: int) -> bytes:
        self.state = _ON * self.rig.bridge | _FAULT * self.rig.faulty
        self.voltage = _NO_VALUE if self.rig.spoilt else 30012
        self.rig.faulty = False
        return super()._registers(function, address, count)


class ModbusRig(Rig):
    """A drive whose state has a bit for its bridge, and one for a fault."""

    cycle_s = POLL_s
    keeps_newest = True

    def __init__(self, _: Path, stop_s: float) -> None:
        self._drive, self.faulty = _Drive(), False
        self._drive.rig = self
        stop = {"interlocks__stop_s": str(stop_s)}
        super().__init__(build(**self._drive.link, **_BITS, **stop), Ear())

    async def begin(self) -> None:
        self._drive.start()

    async def end(self) -> None:
        self._drive.stop()

    async def lose(self) -> None:
        self._drive.stop()

    async def restore(self) -> None:
        self._drive.start()

    def show_fault(self) -> None:
        self.faulty = True


class _Reporting(Supply):
    """A supply that tells a rig what it hears, and reports what the rig wants."""

    rig: ScpiRig
    _out, _volts = False, 0.0

    def reply(self, line: str) -> bytes:
        rig, (header, _, value) = self.rig, line.partition(" ")
        if rig.silent or (rig.refuses and line == "*OPC?"):
            return b""
        if rig.refuses and header in {"OUTP", "VOLT"}:
            return b""
        if header == "OUTP":
            self._out = value == "ON"
            rig.hear(bridge=self._out, voltage_V=self._volts)
        elif header == "VOLT":
            self._volts = float(value)
            rig.heard.append((self._out, self._volts))
        rig.feed()
        self.replies["OUTP?"] = str(int(rig.bridge))
        self.replies["MEAS:VOLT?"] = "9.91E37" if rig.spoilt else "+3.0012E+02"
        self.replies["SYST:ERR?"] = "7" if rig.faulty else '+0,"No error"'
        rig.faulty = rig.faulty and line != "SYST:ERR?"
        return super().reply(line)


class ScpiRig(Rig):
    """A supply, each of whose commands is a line."""

    cycle_s = 0.1
    watched = False
    keeps_newest = True

    def __init__(self, _: Path, stop_s: float) -> None:
        self._supply, self.faulty = _Reporting(memory.new_port()), False
        self._supply.rig = self
        tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
        tables["bus"]["port"] = self._supply.port
        tables["interlocks"]["stop_s"] = stop_s
        configuration = validate_configuration(tables, EXAMPLE)
        port = build_port(configuration, asyncio.get_running_loop().time, EXAMPLE)
        super().__init__(port, Ear())

    async def begin(self) -> None:
        await self.restore()

    async def end(self) -> None:
        await self.lose()

    async def lose(self) -> None:
        memory.withdraw(self._supply.port)
        self._supply.hang_up()

    async def restore(self) -> None:
        supply = self._supply
        memory.serve(
            supply.port,
            lambda: asyncio.StreamReaderProtocol(asyncio.StreamReader(), supply.serve),
        )

    def show_fault(self) -> None:
        self.faulty = True
