"""Drives whose wire a test spoils, one class for each kind of bus, all used in the same way.

What they send is made from the specification, cantools and crccheck; they keep what they are told.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import re
import struct
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import can
import cantools
from cantools.database.can.database import Database

from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.config.file import parse_configuration
from adaptdrive.devices.can.bus import open_bus
from tests.unit.config.modbus_documents import parse
from tests.unit.devices import bench as can_bench
from tests.unit.devices.modbus import bench as modbus_bench

TICK_s = 1.0 / 120.0
PATIENT_s = 2.0
"""For faults that take their time: nothing else may trip the drive meanwhile."""

PATIENT_NODE = {
    "interlocks/stale_s": 1.5,
    "interlocks/stuck_distance": 0.0,
    "interlocks/response_factor": 0.0,
    "bus/heartbeat_timeout_s": 2.0,
    "bus/sdo_timeout_s": 2.0,
}
"""A node whose values stand still."""

BOOST_V = 300.12
OUTPUT_V = 3.25
STUCK_V = 400.12
"""Boost voltage while the output is frozen."""

Frames = list[tuple[str, bytes]]
Spoil = Callable[[Frames], Iterable[tuple[float, Frames]]]


class Wire(Protocol):
    """A drive behind a wire."""

    configuration: Configuration

    async def start(self) -> None:
        """Begin to speak."""

    async def stop(self) -> None:
        """Fall silent for good."""

    async def heal(self) -> None:
        """End whatever has been done to the wire."""

    @property
    def told(self) -> tuple[float, bool]:
        """When the drive was last told something, and its bridge."""


def as_it_is(frames: Frames) -> Iterable[tuple[float, Frames]]:
    """A wire that does nothing."""
    return [(0.0, frames)]


def motor_text(stale_s: float = 0.05) -> str:
    """The example on a bus in memory."""
    text = (can_bench.EXAMPLES / "motor.toml").read_text()
    text = text.replace('interface = "udp_multicast"', 'interface = "virtual"')
    return text.replace("stale_s = 0.05 ", f"stale_s = {stale_s} ")


class CanWire:
    """The reference drive.

    Attributes:
        spoil: What becomes of the two frames of a half cycle.
        values: What is sent, by signal.
        bus: The drive's end.
    """

    def __init__(self, text: str = "") -> None:
        source = can_bench.EXAMPLES / "wire.toml"
        self.configuration = parse_configuration(text or motor_text(), source)
        assert isinstance(self.configuration.bus, CanBus)
        self.bus = open_bus(self.configuration.bus)
        database = cantools.database.load_file(self.configuration.bus.database[0])
        assert isinstance(database, Database)
        self.drive = can_bench.Drive(self.bus, database)
        self.spoil: Spoil = as_it_is
        self.values: dict[str, float] = {"BoostVoltage": BOOST_V, "Tachometer": OUTPUT_V}
        self.deaf = False
        self._told = (0.0, False)
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def told(self) -> tuple[float, bool]:
        """When the drive was last told something, and its bridge."""
        return self._told

    async def start(self) -> None:
        asyncio.get_running_loop().add_reader(self.bus.fileno(), self._hear)
        self._keep(self._speak())

    async def stop(self) -> None:
        asyncio.get_running_loop().remove_reader(self.bus.fileno())
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self.bus.shutdown()

    async def heal(self) -> None:
        self.spoil, self.deaf = as_it_is, False
        self.values = {"BoostVoltage": BOOST_V, "Tachometer": OUTPUT_V}

    def frames(self) -> Frames:
        """The good frames of the next half cycle."""
        drive, now_s = self.drive, asyncio.get_running_loop().time()
        bridge = now_s - self._told[0] < 0.5 and self._told[1]
        status = {**can_bench.STATUS, "BridgeOn": int(bridge), "Fault": 0}
        load = {"Tachometer": OUTPUT_V, "HalfCycle": drive.half_cycle}
        drive.half_cycle = (drive.half_cycle + 1) % 65536
        for values in (status, load):
            values.update({name: self.values[name] for name in values.keys() & self.values.keys()})
        return [
            ("DriveStatus", drive.frame("DriveStatus", **status)),
            ("DriveLoad", drive.frame("DriveLoad", **load)),
        ]

    def put(self, frames: Frames) -> None:
        """Send frames now."""
        for name, data in frames:
            self.drive.put(name, data)

    async def _speak(self) -> None:
        begin_s = asyncio.get_running_loop().time()
        for number in itertools.count(1):
            await asyncio.sleep(begin_s + number * TICK_s - asyncio.get_running_loop().time())
            self._keep(self._deliver(list(self.spoil(self.frames()))))

    async def _deliver(self, pieces: list[tuple[float, Frames]]) -> None:
        for delay_s, frames in pieces:
            if delay_s:
                await asyncio.sleep(delay_s)
            self.put(frames)

    def _keep(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _hear(self) -> None:
        while (frame := self.bus.recv(0)) is not None:
            if frame.arbitration_id == 0x080 and not self.deaf and not frame.is_error_frame:
                self._told = asyncio.get_running_loop().time(), bool(frame.data[4] & 1)

    def send_stranger(self) -> None:
        """Send a frame that is not for the daemon."""
        frame = can.Message(arbitration_id=0x321, is_extended_id=False, data=bytes(8))
        with contextlib.suppress(OSError, can.CanError):
            self.bus.send(frame)

    def go_bus_off(self) -> None:
        """Send what the kernel tells of a controller that has left the bus."""
        error = can.Message(arbitration_id=0x40, is_error_frame=True, dlc=8, data=bytes(8))
        self.bus.send(error)


@dataclass
class ModbusWire:
    """The device of the Modbus tests, with its heartbeat."""

    configuration: Configuration
    peer: modbus_bench.Peer
    seen: int = 0
    when_s: float = 0.0

    async def start(self) -> None:
        self.peer.start()

    async def stop(self) -> None:
        self.peer.stop()

    async def heal(self) -> None:
        peer = self.peer
        peer.start()
        peer.spoil, peer.answer = modbus_bench.untouched, lambda pdu: pdu
        peer.speed, peer.voltage, peer.state = OUTPUT_V, round(100 * BOOST_V), None

    @property
    def told(self) -> tuple[float, bool]:
        """When the drive was last told something, and its bridge."""
        writes = self.peer.writes
        if len(writes) > self.seen:
            self.seen, self.when_s = len(writes), asyncio.get_running_loop().time()
        return self.when_s, bool(writes) and bool(writes[-1][1][1])


def modbus_wire(
    kind: str, peer: modbus_bench.Peer | None = None, /, **changes: str | None
) -> ModbusWire:
    """A drive on Modbus; `kind` is `tcp` or `rtu`."""
    peer = peer or modbus_bench.Peer(kind)
    known = {"bus__heartbeat__drive": '"state"', "interlocks__stale_s": "0.25"}
    return ModbusWire(parse(**{**modbus_bench.MAP, **peer.link, **known, **changes}), peer)


def float_dbc(tmp_path: Path) -> Path:
    """The reference DBC with a floating-point tachometer, for values that no integer has."""
    text = (can_bench.EXAMPLES / "adaptdrive.dbc").read_text()
    text = text.replace("0|24@1- (0.000001,0) [-8.388608|8.388606]", "0|32@1- (1,0) [-9|9]")
    text = text.replace("HalfCycle : 24|16", "HalfCycle : 32|16")
    text = re.sub(r"^(CM_ SG_ 257| SG_) LoadCurrent .*\n", "", text, flags=re.MULTILINE)
    path = tmp_path / "float.dbc"
    path.write_text(text + "\nSIG_VALTYPE_ 257 Tachometer : 1;\n")
    return path


@contextlib.asynccontextmanager
async def strung(wire: Wire) -> AsyncIterator[Wire]:
    """Let a drive speak until the block ends."""
    await wire.start()
    try:
        yield wire
    finally:
        await wire.stop()


def with_crc(data: bytes) -> bytes:
    """A frame with the right checksum in its last byte."""
    return can_bench.with_crc(data)


def float_bytes(value: float) -> bytes:
    """A 32-bit floating point number, low byte first."""
    return struct.pack("<f", value)
