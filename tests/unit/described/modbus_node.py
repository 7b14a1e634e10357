"""A device on Modbus that answers as its manual says: its registers, and what it refuses.

Frames are read and made here, from the specification and crccheck alone.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator, Callable, Iterable

from crccheck.crc import CrcModbus

from tests.unit.devices import memory

BITS = {1: "coil", 2: "discrete"}
WORDS = {3: "holding", 4: "input"}
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3


class RefusalError(Exception):
    """An exception reply."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(code)


class ModbusNode:
    """A device behind a TCP port.

    Attributes:
        tables: What each register holds, by table and address from 0; others do not exist.
        functions: Functions that it knows.
        writes: Address and word of each register that was written, in order.
        asked: Functions that were asked for.
        on_write: Called after each word that was written; may raise `RefusalError`.
        most: Registers that one reply may have.
    """

    def __init__(
        self, functions: Iterable[int], *, framing: str = "rtu", device: int = 1, most: int = 125
    ) -> None:
        self.tables: dict[str, dict[int, int]] = {
            name: {} for name in (*BITS.values(), *WORDS.values())
        }
        self.functions = frozenset(functions)
        self.writes: list[tuple[int, int]] = []
        self.asked: list[int] = []
        self.on_write: Callable[[str, int, int], None] = lambda _table, _address, _word: None
        self.most = most
        self.port = 0
        self._framing, self._device = framing, device
        self._tasks: set[asyncio.Task[None]] = set()

    def put(self, table: str, address: int, *words: int) -> None:
        """Let registers from an address on hold words."""
        for number, word in enumerate(words, address):
            self.tables[table][number] = word & 0xFFFF

    def put_float(self, table: str, address: int, value: float, *, low_first: bool = False) -> None:
        """Let two registers hold a float."""
        words = struct.unpack(">2H", struct.pack(">f", value))
        self.put(table, address, *(reversed(words) if low_first else words))

    def written(self, address: int) -> list[int]:
        """Words that a register was given, in order."""
        return [word for at, word in self.writes if at == address]

    @contextlib.asynccontextmanager
    async def served(self) -> AsyncIterator[None]:
        """Serve a port in memory until the block ends."""
        self.port = memory.new_port()
        with memory.serving(self.port, self.serve):
            yield
        for task in [*self._tasks]:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer over one connection until it ends."""
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            while True:
                await (self._tcp if self._framing == "tcp" else self._rtu)(reader, writer)
        except (asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            self._tasks.discard(task)
            writer.close()

    async def _tcp(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await reader.readexactly(7)
        transaction, _, length, device = struct.unpack(">HHHB", head)
        reply = self.reply(await reader.readexactly(length - 1))
        if device == self._device:
            writer.write(struct.pack(">HHHB", transaction, 0, len(reply) + 1, device) + reply)

    async def _rtu(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        request = await reader.readexactly(2)
        if request[1] in {15, 16}:
            request += await reader.readexactly(5)
            request += await reader.readexactly(request[6] + 2)
        else:
            request += await reader.readexactly(6)
        assert CrcModbus.calc(request[:-2]) == int.from_bytes(request[-2:], "little")
        reply = request[:1] + self.reply(request[1:-2])
        if request[0] == self._device:
            writer.write(reply + int(CrcModbus.calc(reply)).to_bytes(2, "little"))

    def reply(self, request: bytes) -> bytes:
        """Return the reply to a request, without what frames it."""
        function = request[0]
        self.asked.append(function)
        try:
            address, number = struct.unpack(">HH", request[1:5])
            return self._done(function, address, number, request[6:])
        except RefusalError as refusal:
            return bytes((function | 0x80, refusal.code))

    def _done(self, function: int, address: int, number: int, data: bytes) -> bytes:
        if function not in self.functions:
            raise RefusalError(ILLEGAL_FUNCTION)
        if function in WORDS:
            words = self._held(WORDS[function], address, number)
            return bytes((function, 2 * number)) + struct.pack(f">{number}H", *words)
        if function in BITS:
            bits = self._held(BITS[function], address, number)
            whole = sum(bool(bit) << at for at, bit in enumerate(bits))
            length = (number + 7) // 8
            return bytes((function, length)) + whole.to_bytes(length, "little")
        if function == 16:
            for at, word in enumerate(struct.unpack(f">{number}H", data), address):
                self._take("holding", at, word)
        else:
            self._take("coil" if function == 5 else "holding", address, number)
        return bytes((function,)) + struct.pack(">HH", address, number)

    def _held(self, table: str, address: int, count: int) -> list[int]:
        if count > self.most:
            raise RefusalError(ILLEGAL_VALUE)
        held = self.tables[table]
        if not all(at in held for at in range(address, address + count)):
            raise RefusalError(ILLEGAL_ADDRESS)
        return [held[at] for at in range(address, address + count)]

    def _take(self, table: str, address: int, word: int) -> None:
        if address not in self.tables[table]:
            raise RefusalError(ILLEGAL_ADDRESS)
        self.on_write(table, address, word)
        self.tables[table][address] = word
        self.writes.append((address, word))
