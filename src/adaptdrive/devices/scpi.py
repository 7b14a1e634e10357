"""A supply that speaks SCPI: one line of text at a time, polled like a register for each value.

Nothing numbers the replies. After one that is missing, or that nothing asked for, the next one
could be that to an earlier request: the connection is given up, which no late reply outlives.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.config import Configuration, polled
from adaptdrive.devices.bus import BusKind, bus_of, polled_cautions, tcp_locks
from adaptdrive.devices.description import Source
from adaptdrive.devices.polled import Port as PolledPort
from adaptdrive.devices.polled import link, mapping
from adaptdrive.devices.polled.registers import Block, Exchange, count, encode_count
from adaptdrive.safety.timing import Timing, timing_of
from adaptdrive.safety.trips import TripKind

_COMPLETE = "*OPC?"
"""Question that a supply answers with 1 once all earlier commands are complete (IEEE 488.2)."""

_SHOWN_BYTES = 40
"""Bytes of an unfinished reply that a message quotes."""


class ScpiConnection(link.PolledLink):
    """An open connection to one supply."""

    def __init__(
        self,
        config: polled.ScpiBus,
        counts: Counter[str],
        clock: Callable[[], float],
        replies: dict[str, str],
    ) -> None:
        """Prepare a connection; nothing is opened yet.

        Args:
            config: Which supply.
            counts: What is counted on it.
            clock: Monotonic clock, in s.
            replies: The last reply to each question is kept here.
        """
        super().__init__(describe_supply(config), config.timeout_s, counts, clock)
        self._config = config
        registers = config.as_registers().registers
        # a reply is the whole word: its bits are taken from the register
        whole = {"mask": None}
        self._values = {
            one.address: (config.values[name], one.model_copy(update=whole))
            for name, one in registers.items()
        }
        self._replies = replies

    async def _connect(self) -> None:
        await self._stream.connect(self._config.host, self._config.port)

    def suspect(self) -> None:
        """Give the connection up: a reply may be one to another request."""
        if self.lost is None:
            self.lost, self.lost_kind = "a reply came that nothing asked for", TripKind.POLL_REFUSED

    async def exchange(
        self, exchange: Exchange, words: list[int], void: link.Void | None = link.never
    ) -> list[int]:
        """Ask for a value, or set one and wait until the supply has done so."""
        if exchange.read is not None:
            return await self._read(exchange.read, void)
        if exchange.write is not None:
            value, register = self._values[exchange.write.address]
            number = count(register, words)
            if number or "{" in (value.write or ""):  # a line without a value is given or not
                await self._set(value, value.line(number), void)
        return []

    async def _set(self, value: polled.ScpiValue, line: str, void: link.Void | None) -> None:
        """Send a command, and wait until the supply has done it, where it can say so."""
        done, lines = self._config.done, [line]
        if value.answer is not None:
            reply = await self._ask(lines, void)
            if not re.fullmatch(value.answer, reply):
                raise link.ExchangeError(f"{reply!r} came in reply to {line!r}")
            lines, void = [], link.never  # it has been sent
        if done:
            reply = await self._ask([*lines, done], void)
            if done == _COMPLETE and reply.lstrip("+") != "1":
                raise link.ExchangeError(f"{reply!r} came in reply to {line!r} and {done}")
        elif lines:
            self._ready(void)
            self._stream.send(self._ended(lines))

    async def _read(self, block: Block, void: link.Void | None) -> list[int]:
        """Return the registers of a value; one that is no number is NaN, or fails."""
        value, register = self._values[block.address]
        question = value.query or ""
        reply = self._replies[question] = await self._ask([question], void)
        try:
            return encode_count(register, value.number(reply))
        except ValueError as problem:
            raise link.ExchangeError(f"{reply!r} came in reply to {question!r}") from problem

    def _ready(self, void: link.Void | None) -> None:
        """Begin a request, unless bytes came that nothing asked for.

        Raises:
            ExchangeError: They did, or the request is not wanted any more.
        """
        if self._stream.received.strip():
            self._counts["foreign"] += 1
            self.suspect()
        self._begin(void)

    async def _ask(self, lines: list[str], void: link.Void | None) -> str:
        """Send lines, and return the line that answers the last one.

        Raises:
            ExchangeError: There is none.
        """
        self._ready(void)
        stream = self._stream
        reply = await self._reply(self._ended(lines), self._first_line)
        if reply is None:
            asked = " and ".join(map(repr, lines)) + self._unfinished()
            if self.lost is None:
                self.lost = f"no reply within {self._timeout_s:g} s to {asked}"
                self.lost_kind = TripKind.NO_LINE_END if stream.received else TripKind.NO_REPLY
            raise link.ExchangeError(self.lost, kind=self.lost_kind)
        stream.received = stream.received[len(reply) :]
        self._counts["received"] += 1
        return reply.decode("ascii", "replace").strip()

    def _ended(self, lines: list[str]) -> bytes:
        """Return lines as they are sent."""
        return b"".join(line.encode() + self._config.end for line in lines)

    def _first_line(self, received: bytes) -> bytes | None:
        line, end, _ = received.partition(self._config.end[-1:])
        return line + end if end else None

    def _unfinished(self) -> str:
        """Quote what came of a reply without its end."""
        came = self._stream.received
        shown = came[:_SHOWN_BYTES].decode("ascii", "replace") + "…" * (len(came) > _SHOWN_BYTES)
        return f"; {shown!r} came without the end of a line, see bus.line_end" if came else ""


def describe_supply(config: polled.ScpiBus) -> str:
    """Return the bus in one phrase, such as `scpi 10.0.0.7:5025`."""
    return f"scpi {config.host}:{config.port}"


class Port(PolledPort):
    """One connection to one supply."""

    def __init__(
        self, supply: polled.ScpiBus, poll: mapping.Poll, timing: Timing, clock: Callable[[], float]
    ) -> None:
        """Prepare a port; nothing is opened yet.

        Args:
            supply: `[bus]`.
            poll: Its values as registers.
            timing: Times of the drive.
            clock: Monotonic clock, in s.
        """
        super().__init__(describe_supply(supply), supply.as_registers(), poll, timing, clock)
        self._supply = supply
        self._replies: dict[str, str] = {}

    def details(self) -> list[str]:
        """The last reply to each question, and what was refused."""
        refused = [line for line in super().details() if line.startswith("refused")]
        return [*(f"{question} {reply}" for question, reply in self._replies.items()), *refused]

    def _explain(self, source: Source[mapping.Named], *_: object) -> str:
        """Name the reply that is refused."""
        question = self._supply.values[source.item.name].query or ""
        reply = self._replies[question]
        return f"{source.quantity}: {question} gives {reply!r}, no number in its range"

    def _unlike(self, item: mapping.Named, words: list[int], *_: object) -> str:
        """Name the reply of a supply that was set to something else."""
        value = self._supply.values[item.name]
        reply, line = self._replies[value.query or ""], value.line(count(item.register, words))
        return f"{value.query} gives {reply!r} after {line!r}"

    def _new_link(self) -> link.PolledLink:
        return ScpiConnection(self._supply, self._counts, self._clock, self._replies)


def _build(
    configuration: Configuration, clock: Callable[[], float], source: Path | str, passive: bool
) -> Port:
    bus = bus_of(configuration, polled.ScpiBus)
    poll = mapping.map_drive(configuration, bus.as_registers(), source, passive=passive)
    return Port(bus, poll, timing_of(configuration), clock)


def _lock_names(configuration: Configuration) -> Iterator[str]:
    """Yield a supply by its name and its addresses."""
    bus = bus_of(configuration, polled.ScpiBus)
    yield describe_supply(bus)
    yield from tcp_locks("scpi", bus.host, bus.port)


SCPI = BusKind(_build, polled_cautions, lock_names=_lock_names)
