"""A drive on Modbus whose wire a test spoils, and an ear for what the port makes of it.

Requests are read and replies are framed here, from the specification and crccheck alone. Each
sample carries its number, so that a test can tell when the values of a reading were taken.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator, Callable, Sequence

from crccheck.crc import CrcModbus

from adaptdrive.app.ports import build_port
from adaptdrive.config.polled import ModbusRtu, ModbusTcp
from adaptdrive.control.signals import Command
from adaptdrive.devices import modbus
from adaptdrive.devices.polled.mapping import Poll, map_drive
from adaptdrive.safety.facts import Reading
from tests.unit.config.modbus_documents import parse
from tests.unit.devices import memory
from tests.unit.devices.bench import Ear, until
from tests.virtual_time import VirtualLoop

TIMEOUT_s = 0.04
QUIET_s = 3.0 * TIMEOUT_s
"""Time after which the port asks a silent line again: no reply of a drive is so late."""

POLL_s = 6 / 120.0
ANSWER_s = 0.002
"""Time from a request to its reply."""

REPEATED = 0x100
"""Registers after which those of the device are found again."""

RUN = Command(current_scale_S=0.0, boost_reference_V=287.65, bridge=True)

MAP: dict[str, str | None] = {
    "bus__poll_ticks": "6",
    "bus__timeout_s": str(TIMEOUT_s),
    "bus__turnaround_s": "0.001",
    "bus__heartbeat__daemon": '"alive"',
    "load__latency_ticks": "6",
    "bus__registers__voltage": (
        "{ address = 0, table = 'input', scale = 0.01, range = { low = 0.0, high = 600.0 } }"
    ),
    "bus__registers__power": "{ address = 2, table = 'input' }",
}
FUNCTION_23: dict[str, str | None] = {
    "bus__write": '"with-read"',
    **{
        f"bus__registers__{name}": f"{{ address = {address}, table = 'holding', {rest} }}"
        for name, address, rest in (
            ("voltage", 10, "scale = 0.01, range = { low = 0.0, high = 600.0 }"),
            ("line", 11, "scale = 0.1"),
            ("power", 12, "type = 'uint16'"),
            ("speed", 13, "type = 'float32'"),
            ("state", 15, "type = 'uint16'"),
        )
    },
}


def reported(changes: dict[str, str | None]) -> dict[str, str | None]:
    """A map whose state register is the report of the bridge."""
    address, table = (15, "holding") if "bus__write" in changes else (5, "input")
    register = f"{{ address = {address}, table = '{table}', type = 'uint16' }}"
    return {**changes, "bus__registers__closed": register, "signals__bridge": '"closed"'}


Pieces = Sequence[tuple[float, bytes]]
Spoil = Callable[[bytes], Pieces]


def untouched(reply: bytes) -> Pieces:
    """A reply as it should be."""
    return [(0.0, reply)]


class Peer(asyncio.Protocol):
    """The device behind the wire.

    Attributes:
        spoil: What becomes of each reply: pieces, and the delay before each.
        answer: What becomes of each reply before it is framed.
        writes: What was written, in order: address and registers.
        taken: When each sample was taken, by its number.
        speed: The regulated quantity.
        voltage: Counts of the boost voltage.
        state: The heartbeat; None to count samples.
        devices: Ids of the devices on the wire, all with the same registers.
        dead: Those of them that do not answer.
        asked: Id of the device of each request.
        connections: How many there have been.
        dropped: How many of them ended with what was under way.
    """

    def __init__(self, kind: str = "tcp", first: int = 0) -> None:
        """Serve nothing yet.

        Args:
            kind: `tcp` or `rtu`.
            first: Address of the measured registers.
        """
        self.kind = kind
        self.address: object = memory.new_port() if kind == "tcp" else "/dev/drive.tty"
        self.first = first
        self.spoil: Spoil = untouched
        self.answer: Callable[[bytes], bytes] = lambda pdu: pdu
        self.writes: list[tuple[int, list[int]]] = []
        self.requests: list[bytes] = []
        self.devices = {1}
        self.dead: set[int] = set()
        self.asked: list[int] = []
        self.taken: dict[int, float] = {}
        self.speed = 3.25
        self.voltage = 30012
        self.state: int | None = None
        self.connections = self.dropped = 0
        self.line: memory.End | None = None

    @property
    def link(self) -> dict[str, str | None]:
        """`[bus]` of a port on this wire."""
        if self.kind == "tcp":
            return {"bus__port": str(self.address)}
        return {
            "bus__type": '"modbus-rtu"',
            "bus__host": None,
            "bus__device": f'"{self.address}"',
            "bus__baud": "115200",
            "bus__form": '"8N1"',
        }

    def start(self) -> None:
        """Take connections."""
        memory.serve(self.address, lambda: self)

    def stop(self) -> None:
        """Close the server, or pull the cable."""
        memory.withdraw(self.address)
        self.hang_up()

    def hang_up(self) -> None:
        """End the connection."""
        if self.line is not None:
            self.line.abort()
            self.line = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, memory.End)
        self.line, self.connections = transport, self.connections + 1

    def connection_lost(self, _: Exception | None) -> None:
        if self.line is not None and self.line.is_closing():
            self.dropped += self.line.is_dropped
            self.line = None

    def put(self, data: bytes) -> None:
        """Put bytes on the wire."""
        if self.line is not None:
            self.line.write(data)

    def data_received(self, data: bytes) -> None:
        """Take a request, and send what becomes of its reply."""
        device, pdu = _unframed(data) if self.kind == "tcp" else _checked(data)
        assert device in self.devices
        self.asked.append(device)
        reply, at_s = self.reply(pdu), ANSWER_s
        if device in self.dead:
            return
        if self.kind == "tcp":
            reply = struct.pack(">2sHHB", data, 0, len(reply) + 1, device) + reply
        else:
            reply = framed(data[:1] + reply)
        assert self.line is not None
        put = self.line.write if self.kind == "tcp" else self.put
        for delay_s, piece in self.spoil(reply):
            at_s += delay_s
            asyncio.get_running_loop().call_later(at_s, put, piece)

    def reply(self, request: bytes) -> bytes:
        """The reply to a request, without what frames it."""
        self.requests.append(request)
        function, address, count = struct.unpack(">BHH", request[:5])
        if function == 16:
            self._write(request[1:6], request[6:])
            return self.answer(request[:5])
        if function == 23:
            self._write(request[5:10], request[10:])
        return self.answer(self._registers(function, address, count))

    def _write(self, head: bytes, data: bytes) -> None:
        address, count, length = struct.unpack(">HHB", head)
        assert (length, len(data)) == (2 * count, 2 * count)
        self.writes.append((address, list(struct.unpack(f">{count}H", data))))

    def _registers(self, function: int, address: int, count: int) -> bytes:
        number = len(self.taken) + 1
        self.taken[number] = asyncio.get_running_loop().time()
        speed = struct.unpack(">2H", struct.pack(">f", self.speed))
        state = number if self.state is None else self.state
        image = [self.voltage, 1204, number, *speed, state]
        words = [image[(a - self.first) % REPEATED] for a in range(address, address + count)]
        return bytes((function, 2 * count)) + struct.pack(f">{count}H", *words)


def _unframed(data: bytes) -> tuple[int, bytes]:
    _, protocol, length, device = struct.unpack(">HHHB", data[:7])
    assert (protocol, length) == (0, len(data) - 6)
    return device, data[7:]


def _checked(data: bytes) -> tuple[int, bytes]:
    assert framed(data[:-2]) == data
    return data[0], data[1:-2]


def framed(message: bytes) -> bytes:
    """A message on a serial line, with its checksum."""
    return message + int(CrcModbus.calc(message)).to_bytes(2, "little")


class Follower(Ear):
    """An ear that calls back for each reading, as the fast loop decides on each."""

    def __init__(self, decide: Callable[[Reading], None] = lambda _: None) -> None:
        super().__init__()
        self.decide = decide

    def on_reading(self, reading: Reading) -> None:
        super().on_reading(reading)
        self.decide(reading)


class Bench:
    """A running port between a peer and an ear."""

    def __init__(self, port: modbus.Port, peer: Peer) -> None:
        self.port = port
        self.peer = peer
        self.ear = Follower()

    async def hears(self, more: int) -> None:
        """Wait for that many more readings."""
        count = len(self.ear.readings) + more
        await until(lambda: len(self.ear.readings) >= count)

    async def asks(self, more: int) -> None:
        """Wait until the drive has been asked that many more times."""
        count = len(self.peer.requests) + more
        await until(lambda: len(self.peer.requests) >= count)

    async def reads(self, more: int) -> None:
        """Wait until the drive has been asked for registers that many more times."""
        count = self._reads() + more
        await until(lambda: self._reads() >= count)

    def _reads(self) -> int:
        return sum(request[0] in {3, 4, 23} for request in self.peer.requests)

    async def runs_until(self, condition: Callable[[], bool]) -> None:
        """Command the drive on, as the fast loop renews it, until a condition holds."""

        def renewed() -> bool:
            self.port.send(RUN)
            return condition()

        await until(renewed)

    async def hears_of_bus(self, up: bool) -> None:
        """Wait until the bus is reported to be up, or lost."""
        await until(lambda: bool(self.ear.bus) and self.ear.bus[-1][0] is up)

    def told(self) -> list[int]:
        """What the drive was told last: V_c and bridge; nothing before the first command."""
        return self.peer.writes[-1][1][:2] if self.peer.writes else []

    async def is_told(self, *words: int) -> None:
        """Wait until the drive was told something."""
        await until(lambda: self.told() == [*words])

    def check_honesty(self) -> None:
        """No reading is older than it says, and none holds what the drive never measured."""
        for reading in self.ear.readings:
            taken_s = self.peer.taken[round(reading.load_power_W)]
            assert reading.oldest_s <= taken_s <= reading.arrival_s
        assert self.mixed_up() == 0

    def mixed_up(self) -> int:
        """How many readings hold values of other registers than their own."""
        own = (self.peer.speed, 300.12)
        return sum(
            (reading.output, round(reading.boost_voltage_V, 6)) != own
            for reading in self.ear.readings
        )


def stand_still(seconds: float) -> None:
    """Let time pass in which nothing of this process runs."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.selector.now_s += seconds


def plan(**changes: str | None) -> Poll:
    """What a poll of a configuration reads and writes."""
    configuration = parse(**changes)
    assert isinstance(configuration.bus, ModbusTcp | ModbusRtu)
    return map_drive(configuration, configuration.bus, "bench.toml", passive=False)


def build(clock: Callable[[], float] | None = None, /, **changes: str | None) -> modbus.Port:
    """The port of the bench's map, with changes."""
    clock = clock or asyncio.get_running_loop().time
    port = build_port(parse(**{**MAP, **changes}), clock, "bench.toml")
    assert isinstance(port, modbus.Port)
    return port


@contextlib.asynccontextmanager
async def benched(kind: str = "tcp", /, **changes: str | None) -> AsyncIterator[Bench]:
    """Run a port against a peer."""
    peer = Peer(kind, 10 if "bus__write" in changes else 0)
    one = Bench(build(**{**peer.link, **changes}), peer)
    peer.start()
    async with ran(one):
        await one.hears(1)
        yield one


@contextlib.asynccontextmanager
async def ran(one: Bench) -> AsyncIterator[None]:
    """Run the port of a bench; it must not end by itself."""
    task = asyncio.create_task(one.port.run(one.ear, lambda: None))
    try:
        yield
    finally:
        task.cancel()
        (outcome,) = await asyncio.gather(task, return_exceptions=True)
        one.peer.stop()
    assert isinstance(outcome, asyncio.CancelledError)


@contextlib.asynccontextmanager
async def driven(
    state: int | None, kind: str = "tcp", /, **changes: str | None
) -> AsyncIterator[Bench]:
    """Run a port whose drive, with this state, was commanded on and has its bridge on."""
    async with benched(kind, **changes) as one:
        if state is not None and "address = 0" not in (changes.get("bus__registers__on") or ""):
            one.peer.state = 0  # it is off before it comes on by the command
            await until(lambda: not one.ear.readings[-1].bridge)
        one.peer.state = state
        one.port.send(RUN)
        await until(lambda: bool(one.peer.writes) and one.ear.readings[-1].bridge)
        yield one
