"""The simulated drive as a supply that speaks SCPI over TCP.

It answers with what was measured in the last half cycle. What is unknown, or not allowed, goes
into its queue of errors, which `SYST:ERR?` or whatever the configuration names for it empties.
"""

import asyncio
import collections
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path

from adaptdrive.config.polled import ScpiBus, ScpiValue
from adaptdrive.config.root import Configuration
from adaptdrive.devices.scpi import describe_supply
from adaptdrive.util.errors import BusError
from adaptdrive_sim.devices.drive import QUANTITIES, DriveNode, Frame, SimulatedDrive

NO_NUMBER = "9.91E37"
_LISTED = 10
UNDEFINED, OUT_OF_RANGE = '-113,"Undefined header"', '-222,"Data out of range"'


class ScpiDrive(DriveNode):
    """One simulated supply."""

    def __init__(self, drive: SimulatedDrive, configuration: Configuration, _source: Path) -> None:
        super().__init__(drive)
        assert isinstance(configuration.bus, ScpiBus)  # noqa: S101 - `KINDS` has looked
        self._config = configuration.bus
        self._signals = configuration.signals
        self._shown: Mapping[str, float] = {}
        self._held: dict[str, float] = {}
        self._errors: collections.deque[str] = collections.deque(maxlen=20)

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the port, pass its description to `opened`, and serve it until cancelled.

        Raises:
            BusError: The port cannot be opened.
        """
        async with self.serving():
            opened(describe_supply(self._config))
            await self._run_half_cycles(self.show)

    @contextlib.asynccontextmanager
    async def serving(self) -> AsyncIterator[None]:
        """Serve the port while the block runs.

        Raises:
            BusError: The port cannot be opened.
        """
        clients: set[asyncio.StreamWriter] = set()

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            clients.add(writer)
            with contextlib.suppress(ConnectionError):
                while line := await reader.readline():
                    reply = self.obey(line.decode("ascii", "replace").strip())
                    writer.write("".join(f"{one}\n" for one in reply).encode())

        try:
            server = await asyncio.start_server(serve, self._config.host, self._config.port)
        except OSError as problem:
            raise BusError(describe_supply(self._config), str(problem)) from problem
        try:
            yield
        finally:
            server.close()
            for one in clients:
                one.close()

    def show(self, frame: Frame) -> None:
        """Keep a half cycle for the questions that follow."""
        self._shown = frame.quantities()

    def obey(self, line: str) -> list[str]:
        """Return the lines that answer a question; obey a command, which has none."""
        self.counts["requests"] += 1
        if line in {"*OPC?", self._config.done}:
            return ["1"]
        for name, value in self._config.values.items():
            if value.query == line:
                return [_reply(value, self._answer(name))]
            head = (value.write or "").partition("{")[0]
            if value.write is not None and line.startswith(head):
                self._take(name, value, line.removeprefix(head))
                return []
        self._queue_error(UNDEFINED)
        return []

    def _answer(self, name: str) -> str:
        for quantity, source, _ in self._signals.entries():
            if source.signal != name or quantity not in QUANTITIES:
                continue
            if quantity == "fault":
                return self._next_error()
            if not self._shown:
                return NO_NUMBER
            number = (self._shown[quantity] - source.offset) / source.scale
            return f"{number:.0f}" if quantity == "bridge" else f"{number:.8E}"
        held = self._held.get(name, 0.0)
        return f"{held:.0f}" if self._config.values[name].whole else f"{held:.8E}"

    def _next_error(self) -> str:
        if self._errors:
            return self._errors.popleft()
        fault = int(self._shown.get("fault", 0))
        return f'{fault},"Protection"' if fault else '+0,"No error"'

    def _take(self, name: str, value: ScpiValue, argument: str) -> None:
        """Keep a number that is in range, and obey the command that results."""
        plain = value.model_copy(update={"reply": "(.*)"})
        number, limits = plain.number(argument), value.range
        if limits is not None and not limits.low <= number <= limits.high:
            self._queue_error(OUT_OF_RANGE)
            return
        self._held[name] = number
        command = self._signals.command
        reference, bridge = command.boost_reference_V, command.bridge
        if reference is None or bridge is None or name not in {reference.signal, bridge.signal}:
            return
        wanted_V = self._held.get(reference.signal, 0.0) * reference.scale + reference.offset
        self._obey({"boost_reference_V": wanted_V, "bridge": self._held.get(bridge.signal, 0.0)})

    def _queue_error(self, error: str) -> None:
        self._errors.append(error)
        self._refuse(error)


def _reply(value: ScpiValue, number: str) -> str:
    """Return a reply that the configuration finds a number in: with its words, or in a list."""
    if "(.*)" in value.reply:
        return value.reply.replace("(.*)", number)
    return ",".join([number] * _LISTED)
