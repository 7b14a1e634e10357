"""What Modbus and SCPI have in common: a port that polls on a grid, and writes the newest command.

A poll in which every block was read makes one reading, whose values are as old as the first of its
requests; one that must not be used is the last good one, which grows old until it trips the drive.
A command waits for the end of the poll under way, the safe command only for the end of the exchange
under way.
"""

import contextlib
from collections.abc import Callable

from adaptdrive.config.polled import ModbusBus
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.bus import pulse_reset
from adaptdrive.devices.polled import commander, reports
from adaptdrive.devices.polled.link import ExchangeError, OvertakenError, PolledLink, Polling
from adaptdrive.devices.polled.mapping import Named, Poll, explain, written
from adaptdrive.devices.polled.registers import Block, Exchange
from adaptdrive.devices.port import Listener
from adaptdrive.safety.monitor import Doubt, Monitor
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.errors import BusError

_MIXED_UP = (
    "replies come that nothing asked for, and one read of this map may be taken for the next: two "
    "devices with the same id, or a line that repeats"
)


class Port(Polling[PolledLink, Listener]):
    """One connection to one drive that is polled."""

    _explain = staticmethod(explain)
    must_open = False
    """True where a link that cannot be opened at the first attempt is an error."""

    def __init__(
        self,
        description: str,
        bus: ModbusBus,
        poll: Poll,
        timing: Timing,
        clock: Callable[[], float],
    ) -> None:
        super().__init__(description, timing.reading_s, clock)
        self._timeout_s = bus.timeout_s
        self._poll = poll
        slack_s = 0.0 if poll.bridge_block else None
        self.monitor = Monitor(timing, clock, slack_s=slack_s, acknowledges=True)
        look_s = reports.look_limit_s(bus.timeout_s, len(poll.writes))
        self._history = reports.PollHistory(self.monitor, timing, look_s, clock)
        self._commander = commander.Commander(
            poll, self.monitor, self._history, self._counts, clock
        )
        self._link: PolledLink | None = None
        self._assembly = reports.PollAssembly(poll, bus.heartbeat, self._explain)
        self._failure: Trip | None = None

    @property
    def trip_cause(self) -> Trip | None:
        """Reason not to energise the drive: it does not accept its commands, or had a fault."""
        return (
            self.monitor.trip_cause
            or self._commander.trip_cause
            or self._assembly.faults.trip_cause
        )

    async def run(self, listener: Listener, opened: Callable[[], None]) -> None:
        """Open the link, call `opened`, and poll until cancelled; reconnect when it is lost.

        A drive on TCP that is not there yet is waited for, like one that is switched off.

        Args:
            listener: Receiver of readings and of the state of the bus.
            opened: Called once, when the port is ready.

        Raises:
            BusError: The serial port cannot be opened at the first attempt.
        """
        self._listener = listener
        link, problem = await self._try()
        if link is None and self.must_open:
            raise BusError(self.description, problem)
        opened()
        await self._run(link, problem)

    def send(self, command: Command) -> bool:
        """Give the drive a command with the next exchange; a later one takes its place.

        Args:
            command: Command to the drive; it must have passed the guard.

        Returns:
            Whether there is a link to send it on; False is counted.

        Raises:
            ValueError: A value is not finite, or its register cannot hold it.
        """
        self._commander.set(command)
        if self._link is None:
            self._counts["send_drops"] += 1
            return False
        if self._commander.urgent:
            self._wake.set()
        return True

    async def reset_fault(self) -> None:
        """Switch the reset of the drive's fault on and off with the next writes, if it has one."""
        sinks = (sink for _, written in self._poll.writes for sink in written)
        await pulse_reset(sinks, self._cycle_s)

    def explain_age(self) -> Trip:
        """Return the missing registers of the last poll; every value is as old as its poll."""
        since = "since the last reading" if self._assembly.raw else "yet"
        why = self._failure or Trip(TripKind.NO_REPLY, f"no reply has come {since}")
        return Trip(why.kind, f"the polls give no reading: {why}")

    def details(self) -> list[str]:
        """The registers of the last poll, raw, and what was refused."""
        read = [
            f"registers {block} = [{' '.join(f'{word:04x}' for word in words)}]"
            for block, words in self._assembly.raw.items()
        ]
        problems = (self._failure, self._commander.refused_write)
        return [*read, *(f"refused: {one}" for one in problems if one)]

    async def _serve(self, link: PolledLink) -> None:
        """Poll over an open link until it is lost or the port is closed; leave the drive safe."""
        self._link = link
        self._assembly.forget_heartbeat()
        self._commander.begin()
        next_s, hurried = self._clock(), False
        try:
            await self._set_up(link)
            while link.lost is None and not self._closing:
                self._history.note_step()
                start_s = self._clock()
                await self._poll_once(link)
                hurried = not hurried and self._commander.is_starved(start_s)
                due_s = self._next(next_s)
                if hurried:  # once, before the drive's own time-out ends
                    due_s = min(due_s, start_s + self._timeout_s)
                else:
                    next_s = due_s
                await self._idle(link, due_s)
            await self._commander.leave_safe(link)
        except Exception:
            with contextlib.suppress(Exception):  # the first problem counts
                await self._commander.leave_safe(link)
            raise
        finally:
            self._link = None

    async def _set_up(self, link: PolledLink) -> None:
        """Write what the drive needs before it is commanded; a link without that is lost."""
        answered = False
        for block, sink, reads in self._poll.setup:
            words, name = written(sink, SAFE_COMMAND, 0), sink.item.name
            try:
                if not (reads or answered):  # what comes after a read shows whether the line echoes
                    await self._ask(link, Exchange(read=self._poll.reads[0][0]), [])
                answered = True
                if reads and await self._ask(link, Exchange(read=block), []) == words:
                    continue
                await self._ask(link, Exchange(write=block), words)
                held = await self._ask(link, Exchange(read=block), []) if reads else words
            except ExchangeError as failure:
                problem = failure.problem
            else:
                if held == words:
                    continue
                problem = self._unlike(sink.item, words, held, block)
            await self._commander.leave_safe(link)
            link.lost = link.lost or f"set-up of {name!r}: {problem}"
            return

    def _unlike(self, _: Named, words: list[int], held: list[int], block: Block) -> str:
        """Name what a drive keeps in place of what it was set to."""
        found, wanted = (" ".join(f"{one:04x}" for one in part) for part in (held, words))
        return f"{block} holds {found} after {wanted} was written"

    async def _ask(self, link: PolledLink, exchange: Exchange, words: list[int]) -> list[int]:
        """Exchange one part of the set-up; a safe command that is urgent goes before it."""
        if self._commander.urgent:
            await self._commander.write(link)
        self._history.note_step()
        return await link.exchange(exchange, words)

    async def _idle(self, link: PolledLink, until_s: float) -> None:
        """Wait for the next poll; a safe command goes out at once."""
        while link.lost is None and not self._closing and self._clock() < until_s:
            self._wake.clear()
            if self._commander.urgent:
                await self._commander.write(link)
            await self._sleep(until_s - self._clock())

    async def _poll_once(self, link: PolledLink) -> None:
        """Read all registers, pass the reading on, and write the resulting command."""
        start_s = self._clock()
        self._begin_cycle()
        try:
            await self._read(link)
        except OvertakenError:
            pass  # the drive was not asked
        except ExchangeError as failure:
            self._failure = Trip(failure.kind, failure.problem)
            self._commander.note_read(answered=False)
            self._note_silence(failure.problem)
        else:
            if self._was_silent:  # it may have started anew
                self._silent = 0
                await self._set_up(link)
            self._commander.note_read(answered=True)
            if self._is_mixed_up:
                self._failure = Trip(TripKind.POLL_REFUSED, _MIXED_UP)
                link.suspect()  # the replies that are left would answer the next poll
            else:
                self._take(start_s)
        if link.lost is None and self._commander.pending:
            await self._commander.write(link)

    async def _read(self, link: PolledLink) -> None:
        """Read every block.

        Raises:
            ExchangeError: The drive did not give one of the blocks.
        """
        assembly = self._assembly
        assembly.begin()
        joined = self._commander.begin_poll()
        for block, sources in self._poll.reads if joined else self._poll.bridge_last:
            if self._commander.urgent:
                await self._commander.write(link)
            words = await self._commander.read(link, Exchange(read=block), joined=joined)
            joined = False
            assembly.take(block, sources, words)
        refusal = assembly.refusal
        self._failure = Trip(TripKind.VALUE_REFUSED, refusal) if refusal else None
        self._counts["out_of_range"] += bool(refusal)

    def _take(self, start_s: float) -> None:
        """Hand out the reading of a poll; none of a drive that stands still."""
        if not self._is_alive(start_s):
            return
        assembly, sent = self._assembly, self._history.bridge
        reading = assembly.reading(self._clock(), start_s, bridge_sent=sent)
        powered = assembly.bridge(sent)
        if powered is not None:
            self._history.note_bridge(powered=powered)
        if reading is None:
            return
        self._silent = 0
        self._note_bus(up=True)
        if self._listener is not None:
            assembly.faults.clear(reading.fault)
            self._listener.on_reading(reading)

    def _is_alive(self, start_s: float) -> bool:
        alive = self._assembly.is_alive(start_s)
        if alive is False:
            self._counts["counter_stuck"] += 1
            self.monitor.doubt(Doubt.STANDS, self._clock())  # its controller hangs
            self._failure = Trip(TripKind.HEARTBEAT_STANDS, reports.STANDS_STILL)
        return alive is True
