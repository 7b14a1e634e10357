"""Writing of commands to a drive on Modbus, and what the drive has acknowledged of them."""

import math
from collections import Counter
from collections.abc import Callable, Iterable

from adaptdrive.config.references import DAY_S
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices import binding, description
from adaptdrive.devices.polled import reports
from adaptdrive.devices.polled.link import ExchangeError, OvertakenError, PolledLink, Void
from adaptdrive.devices.polled.mapping import HEARTBEAT, Named, Poll, block_words
from adaptdrive.devices.polled.registers import Block, Exchange
from adaptdrive.safety.monitor import Monitor, Verdict
from adaptdrive.safety.trips import Trip


class WritePace:
    """Keeps what the drive has acknowledged of each block, and since when."""

    def __init__(self, poll: Poll, clock: Callable[[], float]) -> None:
        """Let each block be written."""
        self._clock = clock
        self._interval_s = poll.interval_s
        self._least_s = {block: _least_s(sinks) for block, sinks in poll.writes}
        self._switches = {block for block, sinks in poll.writes if _has_switch(sinks)}
        self._resets = {
            block for block, sinks in poll.writes if all(one.reset is not None for one in sinks)
        }
        self._held: dict[Block, list[int] | None] = {}
        self._written_s: dict[Block, float] = {}

    def forget(self) -> None:
        """Begin a link: the drive may hold other registers; the times of the writes stay."""
        self._held.clear()

    def is_due(self, block: Block, words: list[int]) -> bool:
        """Return whether a block is written now, with some registers."""
        age_s = self._clock() - self._written_s.get(block, -math.inf)
        limited = self._least_s[block]
        if self._held.get(block) == words:
            repeated = not limited and block not in self._resets
            return repeated and age_s >= self._interval_s
        return age_s >= limited or block in self._switches

    def note(self, block: Block, words: list[int] | None = None) -> None:
        """Note what the drive holds of a block; None for what is unknown until its reply."""
        self._held[block] = words
        self._written_s[block] = self._clock()


def _has_switch(sinks: Iterable[description.Sink[Named]]) -> bool:
    """Return whether a block has the switch of the bridge, by which a stop begins."""
    return any(sink.name == binding.BRIDGE and sink.factor != 0.0 for sink in sinks)


def _least_s(sinks: Iterable[description.Sink[Named]]) -> float:
    """Return the least time between two writes, 0 for registers that endure any number."""
    limits = (one.item.register.write_limit for one in sinks)
    return max((DAY_S / limit for limit in limits if limit is not None), default=0.0)


class Commander:
    """The newest command of one drive; nothing is queued behind it.

    Attributes:
        monitor: The facts of the drive.
    """

    def __init__(
        self,
        poll: Poll,
        drive: Monitor,
        history: reports.PollHistory,
        counts: Counter[str],
        clock: Callable[[], float],
    ) -> None:
        """Hold no command yet.

        Args:
            poll: Registers of the drive.
            drive: The facts of the drive.
            history: Which commands may still go out.
            counts: `sent`, `send_drops` and `withheld_commands` are counted here.
            clock: Monotonic clock, in s.
        """
        self.monitor = drive
        self._poll = poll
        self._pace = WritePace(poll, clock)
        self._counts = counts
        self._clock = clock
        self._command: Command | None = None
        self._written: Command | None = None
        self._withheld = False
        self._history = history
        self._untaken = reports.UntakenCommands()
        self._alive = 0

    @property
    def refused_write(self) -> str:
        """Reason why the last command was not taken, empty if it was."""
        return f"command: {self._untaken.last}" if self._untaken.last else ""

    @property
    def trip_cause(self) -> Trip | None:
        """Reason not to energise the drive: it does not accept its commands."""
        return self._untaken.trip_cause

    @property
    def urgent(self) -> bool:
        """True if the safe command must be sent before anything else."""
        return self._command == SAFE_COMMAND and self.monitor.safe_s == math.inf

    @property
    def _at_once(self) -> bool:
        """True if the command cannot wait for a silent line, unless only silence can prove it."""
        return self.urgent and not self._untaken.doubtful

    @property
    def _disobeyed(self) -> bool:
        """True if the drive is still energised, or may be, long after it was commanded safe."""
        return self.monitor.verdict is Verdict.DISOBEYS

    @property
    def pending(self) -> bool:
        """True if a command must be written after the read of a poll."""
        return not self._poll.combined or self._command != self._written

    def set(self, command: Command) -> None:
        """Make a command the newest.

        Raises:
            ValueError: A value is not finite, or its register cannot hold it.
        """
        for block, sinks in self._poll.writes:
            block_words(block, sinks, command, 0)
        self._history.renew(command)
        self._command = command
        self._withheld = False

    def begin(self) -> None:
        """Forget what was acknowledged on the link before."""
        self._untaken.clear()
        self._pace.forget()
        self._history.begin()

    def note_read(self, *, answered: bool) -> None:
        """Note the end of a poll.

        Args:
            answered: Whether the drive answered.
        """
        if not answered:  # it may have started anew
            self._pace.forget()
        self._history.silent = not answered
        self._history.note_silence()

    def begin_poll(self) -> bool:
        """Begin a poll; return whether the command goes with its first read.

        A command that energises does so only while nothing is unusual: the drive takes it before
        it reports, and one that had stopped by itself would be switched on unseen. Otherwise the
        drive is read first, and the command follows.
        """
        self._history.note_silence()
        joins = self._poll.combined and self._newest(joined=True) is not None
        if not joins:
            self._written = None  # it takes none with this read
            self._history.forget_report()
        return joins

    def is_starved(self, since_s: float) -> bool:
        """Return whether a drive that is commanded on has taken no command since a time."""
        command = self._command
        return command is not None and command.bridge and self._history.fed_s < since_s

    async def read(self, link: PolledLink, exchange: Exchange, *, joined: bool) -> list[int]:
        """Read a block, and write the command with it where it joins the read.

        Raises:
            ExchangeError: The drive did not give the block.
        """
        command = self._newest(joined=True) if joined else None
        try:
            if command is None:
                registers = await self._read(link, exchange)
            else:
                registers = await self._read_with(link, exchange, command)
        finally:
            if joined:
                self._history.forget_report()
        if self._poll.bridge_block in {None, exchange.read}:
            self._history.reported_s = link.asked_s
        return registers

    async def _read_with(self, link: PolledLink, exchange: Exchange, command: Command) -> list[int]:
        """Read a block and write a command at once.

        Raises:
            ExchangeError: The drive did not give the block.
        """
        block, _ = self._poll.writes[0]
        words = self._words(command)[0]
        void = None if self._at_once else lambda: not self._may_go(command, joined=True)
        self._begin_write(command)
        both = Exchange(exchange.read, block)
        try:
            registers = await self._exchange(link, both, words, void)
        except OvertakenError:
            return await self._read(link, exchange)
        except ExchangeError as failure:
            self._untaken.note(failure, silent=self._history.silent)
            if failure.code is None:
                raise
            return await self._read(link, exchange)
        self._confirm(command, link.asked_s)
        return registers

    async def write(self, link: PolledLink) -> None:
        """Write the newest command, unless it is void, or the drive was not seen in this poll.

        One that has the bridge off begins with that: the other writes may have no answer.
        """
        command = self._newest()
        if command is None:
            self._count_withheld()
            return
        void = None if self._at_once else lambda: not self._may_go(command)
        parts = [*zip(self._poll.writes, self._words(command), strict=True)]
        if not command.bridge:
            parts.sort(key=lambda part: not _has_switch(part[0][1]))
        must_stop = command == SAFE_COMMAND and (self.urgent or self.monitor.powered)
        self._begin_write(command)
        taken, sent = True, False
        for (block, sinks), registers in parts:
            if self._disobeyed and all(sink.name == HEARTBEAT for sink in sinks):
                continue
            if any(sink.only not in {None, command.bridge} for sink in sinks):
                self._pace.note(block)  # the other coil ends what it has begun
                continue
            if not (must_stop or self._pace.is_due(block, registers)):
                continue
            sent = True
            if taken or (command == SAFE_COMMAND and link.lost is None):
                taken &= await self._wrote(link, block, registers, void)
        if taken:
            self._confirm(command, link.asked_s, sent=sent)

    async def leave_safe(self, link: PolledLink) -> None:
        """Write the safe command as the last one, unless it is in force or none was ever given."""
        if link.lost is None and self.monitor.safe_s == math.inf and self._command is not None:
            self._command = SAFE_COMMAND
            await self.write(link)

    async def _read(self, link: PolledLink, exchange: Exchange) -> list[int]:
        """Read a block, unless the safe command becomes urgent before it is asked for.

        Each look during the wait for a silent line is a step: the wait is no standstill.
        """
        known = self.urgent

        def overtaken() -> bool:
            self._history.note_step()
            return self.urgent and not known

        return await self._exchange(link, exchange, [], overtaken)

    async def _exchange(
        self, link: PolledLink, exchange: Exchange, words: list[int], void: Void | None
    ) -> list[int]:
        """Ask the link, and note that the process runs.

        Raises:
            ExchangeError: As the link does.
        """
        self._history.note_step()
        try:
            return await link.exchange(exchange, words, void)
        finally:
            self._history.note_step()

    async def _wrote(
        self, link: PolledLink, block: Block, words: list[int], void: Void | None
    ) -> bool:
        """Write one block of a command; whether the drive has taken it."""
        self._pace.note(block)
        try:
            await self._exchange(link, Exchange(write=block), words, void)
        except OvertakenError:
            self._count_withheld()
            return False
        except ExchangeError as failure:
            self._counts["send_drops"] += 1
            self._untaken.note(failure, silent=self._history.silent)
            return False
        self._pace.note(block, words)
        return True

    def _count_withheld(self) -> None:
        """Count the newest command once if it must not go out; one that is replaced is not it."""
        if self._command is not None and not self._withheld and self._newest() is None:
            self._withheld = True
            self._counts["withheld_commands"] += 1

    def _newest(self, *, joined: bool = False) -> Command | None:
        """Return the newest command, None where it must not go out as for `_may_go`."""
        command = self._command
        return command if command is not None and self._may_go(command, joined=joined) else None

    def _may_go(self, command: Command, *, joined: bool = False) -> bool:
        """Return whether a command may be written now, joined with a read or after the read.

        One that is not safe may do so while the newest one is not safe either, and still valid.
        """
        newest = self._command
        if command == SAFE_COMMAND or newest is None:
            return True
        valid = newest != SAFE_COMMAND and self._history.admits(newest)
        return valid and self._history.may_go(command, joined=joined)

    def _words(self, command: Command) -> list[list[int]]:
        """The registers of every block that is written, with the next heartbeat.

        The heartbeat stands still for a drive that does not obey: its own watchdog ends that.
        """
        self._alive += not self._disobeyed
        return [block_words(*one, command, self._alive) for one in self._poll.writes]

    def _begin_write(self, command: Command) -> None:
        """Mark the drive's command as unknown, from the first byte sent until the reply."""
        self._written = None
        self.monitor.offer(command)

    def _confirm(self, command: Command, asked_s: float, *, sent: bool = True) -> None:
        self._counts["sent"] += sent
        self._written = command
        self._history.take(command, asked_s)
        self._untaken.clear()
