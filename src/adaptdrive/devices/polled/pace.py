"""Pace at which blocks of a command are written, and commands that a drive has not taken."""

import math
from collections.abc import Callable, Iterable

from adaptdrive.config.references import DAY_S
from adaptdrive.devices.binding import BRIDGE, Sink
from adaptdrive.devices.polled import link, mapping, registers

_REFUSED_WRITES = 2
"""Commands refused in a row after which the drive counts as refusing."""

_UNTAKEN_WRITES = 5
"""Commands in a row that a drive which answers reads has not taken, for whatever reasons.

Where one reply in twenty is lost, five in a row are within days, and three within minutes.
"""

_BUSY = frozenset({5, 6})
"""Exception codes of a drive that has no time for a command, and does not refuse it."""


class WritePace:
    """Keeps what the drive has acknowledged of each block, and since when."""

    def __init__(self, poll: mapping.Poll, clock: Callable[[], float]) -> None:
        """Let each block be written.

        Args:
            poll: The blocks of a command.
            clock: Monotonic clock, in s.
        """
        self._clock = clock
        self._interval_s = poll.interval_s
        self._least_s = {block: _least_s(sinks) for block, sinks in poll.writes}
        self._switches = {block for block, sinks in poll.writes if has_switch(sinks)}
        self._resets = {
            block for block, sinks in poll.writes if all(one.reset is not None for one in sinks)
        }
        self._held: dict[registers.Block, list[int] | None] = {}
        self._written_s: dict[registers.Block, float] = {}

    def forget(self) -> None:
        """Begin a link: the drive may hold other registers; the times of the writes stay."""
        self._held.clear()

    def is_due(self, block: registers.Block, words: list[int]) -> bool:
        """Return whether a block is written now.

        Args:
            block: The block.
            words: Its registers.
        """
        age_s = self._clock() - self._written_s.get(block, -math.inf)
        limited = self._least_s[block]
        if self._held.get(block) == words:
            repeated = not limited and block not in self._resets
            return repeated and age_s >= self._interval_s
        return age_s >= limited or block in self._switches

    def note(self, block: registers.Block, words: list[int] | None = None) -> None:
        """Note what the drive holds of a block; None for what nobody knows until its reply."""
        self._held[block] = words
        self._written_s[block] = self._clock()


def has_switch(sinks: Iterable[Sink[mapping.Named]]) -> bool:
    """Return whether a block has the switch of the bridge, by which a stop begins."""
    return any(sink.name == BRIDGE and sink.factor != 0.0 for sink in sinks)


def _least_s(sinks: Iterable[Sink[mapping.Named]]) -> float:
    """Return the least time between two writes, 0 for registers that endure any number."""
    limits = (one.item.register.write_limit for one in sinks)
    return max((DAY_S / limit for limit in limits if limit is not None), default=0.0)


class UntakenCommands:
    """Counts of commands that failed since the last one that the drive acknowledged.

    Attributes:
        doubtful: Whether the reply to the last one may still come: only silence shows that none is
            on its way.
    """

    def __init__(self) -> None:
        self._refused = self._untaken = 0
        self.doubtful = False
        self.last = ""

    @property
    def complaint(self) -> str | None:
        """Reason not to energise the drive, None while too few commands have failed."""
        if self._refused < _REFUSED_WRITES and self._untaken < _UNTAKEN_WRITES:
            return None
        does = "refuses" if self._refused else "does not answer"
        check = "check [bus.registers], its remote mode and write access"
        return f"the drive {does} commands: {self.last}; {check}"

    def note(self, failure: link.ExchangeError, *, silent: bool) -> None:
        """Note that the drive has not taken a command, or not provably.

        Args:
            failure: What came of it.
            silent: Whether the drive answers no reads either: it ignores more than commands.
        """
        self.doubtful = failure.doubtful
        refused = failure.code is not None and failure.code not in _BUSY
        self._refused = self._refused + 1 if refused else 0
        self._untaken += not silent
        self.last = failure.problem

    def clear(self) -> None:
        """Note that the drive has acknowledged a command, or begin anew on another link."""
        self._refused = self._untaken = 0
        self.doubtful = False
        self.last = ""
