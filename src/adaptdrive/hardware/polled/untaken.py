"""Commands in a row that a polled drive has not taken, and the word on them."""

from __future__ import annotations

from adaptdrive.hardware.polled.capacity import Exchange
from adaptdrive.hardware.polled.link import EXCEPTIONS, ExchangeError

_REFUSED_WRITES = 2
"""Commands refused in a row after which the drive counts as refusing."""

_UNTAKEN_WRITES = 5
"""Commands in a row that a drive which answers reads has not taken, for whatever reasons.

Where one reply in twenty is lost, five in a row are within days, and three within minutes.
"""

_BUSY = frozenset({5, 6})
"""Exception codes of a drive that has no time for a command, and does not refuse it."""


class UntakenCommands:
    """Counts of commands that failed since the last one that the drive acknowledged.

    Attributes:
        doubtful: Whether the reply to the last one may still come: only silence shows that none is
            on its way.
    """

    def __init__(self) -> None:
        self._refused = self._untaken = 0
        self._last = ""
        self.doubtful = False

    @property
    def complaint(self) -> str | None:
        """Reason not to energise the drive, None while too few commands have failed."""
        if self._refused < _REFUSED_WRITES and self._untaken < _UNTAKEN_WRITES:
            return None
        does = "refuses" if self._refused else "does not answer"
        return f"the drive {does} commands: {self._last}"

    def note(self, exchange: Exchange, failure: ExchangeError, *, silent: bool) -> None:
        """Note that the drive has not taken a command, or not provably.

        Args:
            exchange: What was asked for.
            failure: What came of it.
            silent: Whether the drive answers no reads either: it ignores more than commands.
        """
        self.doubtful = failure.doubtful
        code, block = failure.code, exchange.write
        reason = failure.problem
        if code is not None:
            reason = f"exception code {code} ({EXCEPTIONS.get(code, 'of its maker')})"
        self._refused = 0 if code is None or code in _BUSY else self._refused + 1
        self._untaken += not silent
        register = "" if block is None else f" at register {block.address}"
        self._last = f"{reason}{register}; check [bus.registers], its remote mode and write access"

    def forget(self) -> None:
        """Begin anew on another link; a reply to the last command may still come."""
        self._refused = self._untaken = 0

    def clear(self) -> None:
        """Note that the drive has acknowledged a command."""
        self.forget()
        self.doubtful = False
