"""Rigs on a CAN bus in memory: a drive of a DBC, and a CiA 402 node of the canopen library."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from pathlib import Path

import can
import pytest

from adaptdrive.app.ports import build_port
from adaptdrive.config.bus import CanLink
from adaptdrive.devices.can.bus import open_bus
from adaptdrive.util.errors import BusError
from tests.contracts.port.rig import Rig
from tests.unit.devices.bench import (
    MOTOR,
    STATUS,
    Drive,
    Ear,
    memory_bus,
    reference_database,
    with_crc,
)
from tests.unit.devices.canopen.documents import MEMORY, other_eds, parse
from tests.unit.devices.canopen.peer import ENABLED, FAULT, MEASURED, REST, Peer

_LIMITED = "ParameterName=DC link circuit voltage\n"
_NO_VALUE = b"\xff\xff"
_IMPOSSIBLE_mV = 0xFFFF_FFFF


class _CanRig(Rig):
    """A rig whose bus is taken away by closing it under the port."""

    command_id: int
    _lost = False

    async def begin(self) -> None:
        self._patch = pytest.MonkeyPatch()
        self._patch.setattr("adaptdrive.devices.can.connection.open_bus", self._open)

    async def end(self) -> None:
        self._patch.undo()

    async def lose(self) -> None:
        self._lost = True
        self._bus.shutdown()

    async def restore(self) -> None:
        self._lost = False

    def _open(self, config: CanLink, listen: Iterable[int]) -> can.BusABC:
        if self._lost:
            raise BusError("bench", "unplugged")
        self._bus = open_bus(config, listen)
        take = self._bus.send

        def send(frame: can.Message, timeout: float | None = None) -> None:
            if self.refuses and frame.arbitration_id == self.command_id:
                raise can.CanOperationError("Transmit buffer full")
            take(frame, timeout)

        setattr(self._bus, "send", send)  # noqa: B010 - a method of one object
        return self._bus


class DbcRig(_CanRig):
    """A drive of the reference DBC, which cantools and crccheck write and read."""

    command_id = 0x080

    def __init__(self, _: Path, stop_s: float) -> None:
        self._config = memory_bus()
        interlocks = MOTOR.interlocks.model_copy(update={"stop_s": stop_s})
        changes = {"bus": self._config, "interlocks": interlocks}
        clock = asyncio.get_running_loop().time
        super().__init__(build_port(MOTOR.model_copy(update=changes), clock, "motor.toml"), Ear())
        self._fault = 0
        self._message = reference_database().get_message_by_name("DriveCommand")

    async def begin(self) -> None:
        await super().begin()
        self._drive = Drive(open_bus(self._config))
        asyncio.get_running_loop().add_reader(self._drive.bus.fileno(), self._hear)
        self._reporting = asyncio.create_task(self._report())

    async def end(self) -> None:
        self._reporting.cancel()
        await asyncio.gather(self._reporting, return_exceptions=True)
        asyncio.get_running_loop().remove_reader(self._drive.bus.fileno())
        self._drive.bus.shutdown()
        await super().end()

    def show_fault(self) -> None:
        self._fault = 4

    async def _report(self) -> None:
        while True:
            if not self.silent:
                self._send_both()
            await asyncio.sleep(self.cycle_s)

    def _send_both(self) -> None:
        words = {"BridgeOn": int(self.bridge), "Fault": self._fault}
        status = self._drive.frame("DriveStatus", **(STATUS | words))
        if self.spoilt:
            status = with_crc(_NO_VALUE + status[2:])
        self._drive.put("DriveStatus", status)
        if self._fault:  # the report before the clocking frame is a healthy one again
            self._fault = 0
            self._drive.send_status(BridgeOn=int(self.bridge))
        self._drive.send_load()

    def _hear(self) -> None:
        while (frame := self._drive.bus.recv(0)) is not None:
            assert frame.arbitration_id == self.command_id
            assert with_crc(bytes(frame.data)) == bytes(frame.data)
            told = self._message.decode_simple(bytes(frame.data), decode_choices=False)
            self.feed()
            voltage_V = float(str(told["BoostReference"]))
            self.hear(bridge=told["BridgeEnable"] == 1, voltage_V=voltage_V)


class _Node(Peer):
    """A node that tells a rig what it hears, and reports what the rig wants."""

    rig: CanOpenRig

    def _receive(self, can_id: int, data: bytearray, time_s: float) -> None:
        super()._receive(can_id, data, time_s)
        self.rig.hear(bridge=self.words[-1] == 0x0F, voltage_V=self.references_V[-1])

    def _beat(self, can_id: int, data: bytearray, time_s: float) -> None:
        super()._beat(can_id, data, time_s)
        self.rig.feed()

    def _send_pdos(self) -> None:
        self.obeys = self.rig.obeys
        if self.rig.silent:
            return
        kept = self.statusword
        with pytest.MonkeyPatch.context() as changed:
            if self.rig.spoilt:
                changed.setitem(MEASURED, "0x6079", _IMPOSSIBLE_mV)
            if self.rig.faulty:
                self.rig.faulty, self.statusword = False, FAULT
            super()._send_pdos()
        self.statusword = kept


class CanOpenRig(_CanRig):
    """A CiA 402 drive: each SYNC of the daemon has it report."""

    voltage_V = 250.0
    command_id = 0x205
    outlives_loss = False

    def __init__(self, folder: Path, stop_s: float) -> None:
        self._eds = other_eds(folder, (_LIMITED, f"{_LIMITED}HighLimit=450000\n"))
        times = {"heartbeat_timeout_s": 2.0, "sdo_timeout_s": 10.0}
        self._config = MEMORY.model_copy(update={"eds": self._eds, **times})
        changed = parse({"interlocks/stop_s": stop_s}).model_copy(update={"bus": self._config})
        clock = asyncio.get_running_loop().time
        super().__init__(build_port(changed, clock, "bench.toml"), Ear())
        self.faulty = False

    @property
    def bridge(self) -> bool:
        return self._node.statusword == ENABLED

    @bridge.setter
    def bridge(self, on: bool) -> None:
        """The node itself goes on; off is a state that it can be told of."""
        if not on and hasattr(self, "_node") and self.bridge:
            self._node.statusword = REST

    async def begin(self) -> None:
        await super().begin()
        self._node = _Node(self._config, self._eds)
        self._node.rig = self

    async def end(self) -> None:
        self._node.close()
        await super().end()

    def show_fault(self) -> None:
        self.faulty = True
