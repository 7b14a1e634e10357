"""A drive on Modbus whose wire a test spoils, and an ear for what the port makes of it.

Requests are read and replies are framed here, from the specification and crccheck alone. Each
sample carries its number, so that a test can tell when the values of a reading were taken.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import struct
import time
import tty
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path

import pytest
from crccheck.crc import CrcModbus

from adaptdrive.app.ports import build_port
from adaptdrive.config.modbus import ModbusRtu, ModbusTcp
from adaptdrive.control.signals import Command
from adaptdrive.hardware.modbus.port import ModbusPort
from adaptdrive.hardware.polled.mapping import Poll, map_drive
from tests.config.modbus_documents import parse
from tests.hardware.bench import Ear, until

TIMEOUT_s = 0.04
QUIET_s = 3.0 * TIMEOUT_s
"""Time after which the port asks a silent line again: no reply of a drive is so late."""

_TICK_s, _PROMPT_s = 0.001, 0.005
_ADDED_UP_s = 4.0 * QUIET_s
"""Time before a failure in which a standstill may have caused it: that of three polls."""
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
    "bus__read_write": "true",
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
    address, table = (15, "holding") if "bus__read_write" in changes else (5, "input")
    register = f"{{ address = {address}, table = '{table}', type = 'uint16' }}"
    return {**changes, "bus__registers__closed": register, "signals__bridge": '"closed"'}


Pieces = Sequence[tuple[float, bytes]]
Spoil = Callable[[bytes], Pieces]


def untouched(reply: bytes) -> Pieces:
    """A reply as it should be."""
    return [(0.0, reply)]


class Peer:
    """The device behind the wire.

    Attributes:
        first: Address of the measured registers.
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
    """

    def __init__(self, first: int = 0) -> None:
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

    def reply(self, request: bytes) -> bytes:
        """The reply to a request, without what frames it."""
        self.requests.append(request)
        function = request[0]
        if function in {3, 4}:
            address, count = struct.unpack(">HH", request[1:5])
            return self.answer(self._registers(function, address, count))
        if function == 16:
            self._write(request[1:6], request[6:])
            return self.answer(request[:5])
        address, count = struct.unpack(">HH", request[1:5])
        self._write(request[5:10], request[10:])
        return self.answer(self._registers(function, address, count))

    def _write(self, head: bytes, data: bytes) -> None:
        address, count, length = struct.unpack(">HHB", head)
        assert (length, len(data)) == (2 * count, 2 * count)
        self.writes.append((address, list(struct.unpack(f">{count}H", data))))

    def _registers(self, function: int, address: int, count: int) -> bytes:
        number = len(self.taken) + 1
        self.taken[number] = time.monotonic()
        speed = struct.unpack(">2H", struct.pack(">f", self.speed))
        state = number if self.state is None else self.state
        image = [self.voltage, 1204, number, *speed, state]
        words = [image[(a - self.first) % REPEATED] for a in range(address, address + count)]
        return bytes((function, 2 * count)) + struct.pack(f">{count}H", *words)

    async def send(self, reply: bytes, put: Callable[[bytes], None]) -> None:
        """Put a reply on the wire, as the test wants it."""
        for delay_s, piece in self.spoil(reply):
            await asyncio.sleep(delay_s)
            put(piece)


class TcpPeer(Peer):
    """A Modbus TCP server."""

    def __init__(self, port: int, first: int = 0) -> None:
        super().__init__(first)
        self.port = port
        self.connections = 0
        self.resets = 0
        self._writers: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)

    async def stop(self) -> None:
        """Close the server and every connection; the port may be used again."""
        if self._server is None:
            return
        self._server.close()
        self.hang_up()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._server = None

    def hang_up(self) -> None:
        """Close every connection."""
        for writer in list(self._writers):
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self._writers.add(writer)
        try:
            while True:
                header = await reader.readexactly(7)
                transaction, protocol, length, device = struct.unpack(">HHHB", header)
                assert protocol == 0
                assert device in self.devices
                self.asked.append(device)
                pdu = self.reply(await reader.readexactly(length - 1))
                if device in self.dead:
                    continue
                adu = struct.pack(">HHHB", transaction, 0, len(pdu) + 1, device) + pdu
                task = asyncio.create_task(self.send(adu, writer.write))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
        except ConnectionResetError:
            self.resets += 1
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            self._writers.discard(writer)
            writer.close()


class RtuPeer(Peer):
    """A device on a serial line: the far end of a pseudo-terminal."""

    def __init__(self, link: Path, first: int = 0) -> None:
        super().__init__(first)
        self.link = link
        self._buffer = b""
        self._tasks: set[asyncio.Task[None]] = set()
        self._master = self._slave = -1

    async def start(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self._slave))
        asyncio.get_running_loop().add_reader(self._master, self._hear)

    async def stop(self) -> None:
        """Pull the cable."""
        if self._master < 0:
            return
        asyncio.get_running_loop().remove_reader(self._master)
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        os.close(self._slave)
        os.close(self._master)
        self.link.unlink(missing_ok=True)
        self._master = -1

    def put(self, data: bytes) -> None:
        """Put bytes on the line."""
        if self._master >= 0:
            os.write(self._master, data)

    def _hear(self) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            self._buffer += os.read(self._master, 1024)
        length = _request_length(self._buffer)
        if length is None or len(self._buffer) < length:
            return
        request, self._buffer = self._buffer[:length], b""
        assert framed(request[:-2]) == request
        assert request[0] in self.devices
        self.asked.append(request[0])
        pdu = self.reply(request[1:-2])
        if request[0] in self.dead:
            return
        task = asyncio.create_task(self.send(framed(request[:1] + pdu), self.put))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def framed(message: bytes) -> bytes:
    """A message on a serial line, with its checksum."""
    return message + int(CrcModbus.calc(message)).to_bytes(2, "little")


def _request_length(heard: bytes) -> int | None:
    if len(heard) < 2:
        return None
    if heard[1] in {3, 4}:
        return 8
    at = 6 if heard[1] == 16 else 10
    return None if len(heard) <= at else at + 3 + heard[at]


class Bench:
    """A running port between a peer and an ear."""

    def __init__(self, port: ModbusPort, peer: TcpPeer | RtuPeer, ear: Ear) -> None:
        self.port = port
        self.peer = peer
        self.ear = ear

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
        """Command the drive on until a condition holds.

        The command is renewed, as the fast loop renews it: a standstill of the process voids one.
        """

        def renewed() -> bool:
            self.port.send(RUN)
            return condition()

        await until(renewed)

    def told(self) -> list[int]:
        """What the drive was told last: V_c and bridge."""
        return self.peer.writes[-1][1][:2]

    def check_honesty(self) -> None:
        """No reading is older than it says, and none holds what the drive never measured."""
        for reading in self.ear.readings:
            taken_s = self.peer.taken[round(reading.load_power_W)]
            assert reading.oldest_s <= taken_s <= reading.arrival_s
            assert abs(reading.output - self.peer.speed) < 1e-6
            assert abs(reading.boost_voltage_V - 300.12) < 1e-6

    def mixed_up(self) -> int:
        """How many readings hold values of other registers than their own."""
        own = (self.peer.speed, 300.12)
        return sum(
            (reading.output, round(reading.boost_voltage_V, 6)) != own
            for reading in self.ear.readings
        )


def serial(device: Path) -> dict[str, str | None]:
    """`[bus]` of a drive on a pseudo-terminal."""
    return {
        "bus__type": '"modbus-rtu"',
        "bus__host": None,
        "bus__device": f'"{device}"',
        "bus__baud": "115200",
        "bus__parity": '"none"',
    }


def plan(**changes: str | None) -> Poll:
    """What a poll of a configuration reads and writes."""
    configuration = parse(**changes)
    assert isinstance(configuration.bus, ModbusTcp | ModbusRtu)
    return map_drive(configuration.bus, configuration.signals, 1.0 / 120.0, "bench.toml")


def build(**changes: str | None) -> ModbusPort:
    """The port of the bench's map, with changes."""
    port = build_port(parse(**{**MAP, **changes}), time.monotonic, "bench.toml")
    assert isinstance(port, ModbusPort)
    return port


class Wire:
    """What a port and a drive are joined by: `tcp` or `rtu`."""

    def __init__(self, kind: str, folder: Path, tcp_port: int) -> None:
        self.kind = kind
        self.folder = folder
        self.tcp_port = tcp_port

    def parts(self, **changes: str | None) -> tuple[ModbusPort, TcpPeer | RtuPeer]:
        """A port and a peer, neither of which runs."""
        first = 10 if "bus__read_write" in changes else 0
        peer: TcpPeer | RtuPeer
        if self.kind == "tcp":
            peer = TcpPeer(self.tcp_port, first)
            link: dict[str, str | None] = {"bus__port": str(self.tcp_port)}
        else:
            peer = RtuPeer(self.folder / "drive.tty", first)
            link = serial(peer.link)
        return build(**{**link, **changes}), peer

    @contextlib.asynccontextmanager
    async def bench(self, **changes: str | None) -> AsyncIterator[Bench]:
        """Run a port against a peer."""
        port, peer = self.parts(**changes)
        ear = Ear()
        await peer.start()
        task = asyncio.create_task(port.run(ear, lambda: None))
        try:
            await until(lambda: bool(ear.readings) or task.done())
            yield Bench(port, peer, ear)
        finally:
            task.cancel()
            outcome = await asyncio.gather(task, return_exceptions=True)
            await peer.stop()
        assert isinstance(outcome[0], asyncio.CancelledError)

    @contextlib.asynccontextmanager
    async def driven(self, state: int | None, **changes: str | None) -> AsyncIterator[Bench]:
        """Run a port whose drive, with this state, was commanded on and has its bridge on."""
        async with self.bench(**changes) as one:
            one.peer.state = state
            one.port.send(RUN)
            await until(lambda: bool(one.peer.writes) and one.ear.readings[-1].bridge)
            yield one


@contextlib.asynccontextmanager
async def judged(permitted_s: float) -> AsyncIterator[None]:
    """Judge a failure of the block only if this process ran; drive and port are both in it.

    Args:
        permitted_s: Standstill that the replies of the block may have until they are too late.
    """
    stalls = Stalls()
    ticker = asyncio.create_task(stalls.measure())
    try:
        yield
    except AssertionError:
        stalled_s = stalls.before(time.monotonic())
        if stalled_s > permitted_s:
            pytest.skip(f"not judged: stalled for {stalled_s:.3f} s")
        raise
    finally:
        ticker.cancel()


class Stalls:
    """Standstills of this process, seen by a task that is to run every millisecond."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float]] = deque(maxlen=100)

    async def measure(self) -> None:
        """Watch until cancelled."""
        last_s = time.monotonic()
        while True:
            await asyncio.sleep(_TICK_s)
            now_s = time.monotonic()
            self.note(now_s, now_s - last_s)
            last_s = now_s

    def note(self, now_s: float, passed_s: float) -> None:
        """Take the time from one run of the task to the next."""
        if passed_s > _PROMPT_s:
            self._seen.append((now_s, passed_s))

    def before(self, now_s: float) -> float:
        """Return the sum of the standstills just before: they add up for a reply and its poll."""
        return sum(stall_s for at_s, stall_s in self._seen if now_s - at_s < _ADDED_UP_s)
