"""A supply that speaks SCPI over TCP and answers as its manual says.

It shares no code with the port: one line is one question or one command.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable

from tests.unit.devices import memory


class ScpiNode:
    """A supply behind a TCP port.

    Attributes:
        replies: Reply to each question; others get none, and are counted as errors.
        commands: Commands that it took, in order.
        errors: Lines that it does not know.
        on_command: Called with header and value of each command.
    """

    def __init__(self, headers: tuple[str, ...]) -> None:
        self.replies: dict[str, str] = {"*OPC?": "1"}
        self.commands: list[str] = []
        self.errors: list[str] = []
        self.on_command: Callable[[str, str], None] = lambda _header, _value: None
        self.port = 0
        self._headers = headers
        self._writers: set[asyncio.StreamWriter] = set()

    @contextlib.asynccontextmanager
    async def served(self) -> AsyncIterator[None]:
        """Serve a port in memory until the block ends."""
        self.port = memory.new_port()
        with memory.serving(self.port, self._serve):
            yield
        for writer in self._writers:
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        with contextlib.suppress(ConnectionError):
            while line := (await reader.readline()).decode("ascii").strip():
                writer.write(self._answer(line))
        writer.close()

    def _answer(self, line: str) -> bytes:
        if line.endswith("?") and line in self.replies:
            return f"{self.replies[line]}\n".encode()
        header, _, value = line.partition(" ")
        if line.endswith("?") or header not in self._headers:
            self.errors.append(line)
            return b""
        self.commands.append(line)
        self.on_command(header, value)
        return b""
