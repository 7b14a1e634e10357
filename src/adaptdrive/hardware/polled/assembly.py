"""Putting the blocks of one poll together: a reading, or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from adaptdrive.config.modbus import Heartbeat
from adaptdrive.hardware.binding import BRIDGE, Source
from adaptdrive.hardware.newest import NewestValues
from adaptdrive.hardware.polled.capacity import Block
from adaptdrive.hardware.polled.mapping import HEARTBEAT, Named, Poll, explain, value_in
from adaptdrive.hardware.port import Reading

STANDS_STILL = "the drive's heartbeat register stands still: its controller hangs"


class PollAssembly:
    """Collects the values of the blocks of a poll.

    Attributes:
        faults: Fault word of the drive.
        raw: Registers of each block that was read last.
    """

    def __init__(self, poll: Poll, explain: Callable[..., str] = explain) -> None:
        self._poll = poll
        self._explain = explain
        sources = (one.quantity for _, read in poll.reads for one in read)
        slacks = {name: 0.0 for name in sources if name != HEARTBEAT}
        self._newest = NewestValues(slacks, poll.other, poll.faults)
        self._values: dict[str, float] = {}
        self._refused: dict[str, str] = {}
        self.faults = self._newest.faults
        self.raw: dict[Block, list[int]] = {}

    @property
    def heartbeat(self) -> float | None:
        """Heartbeat of the drive in this poll, None where it must not be used."""
        return self._values.get(HEARTBEAT)

    @property
    def refusal(self) -> str:
        """Reason why values of the poll must not be used, empty where all may be."""
        if not self._refused:
            return ""
        first, *others = self._refused.values()
        return f"{first}, and {len(others)} more" if others else first

    def begin(self) -> None:
        """Begin a poll."""
        self._values.clear()
        self._refused.clear()

    def take(self, block: Block, sources: Sequence[Source[Named]], words: list[int]) -> None:
        """Take one block.

        Args:
            block: Which registers.
            sources: Quantities in them.
            words: Their contents.
        """
        self.raw[block] = words
        for source in sources:
            value = value_in(source, block, words)
            if value is not None:
                self._values[source.quantity] = value
            else:
                self._refused[source.quantity] = self._explain(source, block, words)
        self.faults.see(self._values)

    def bridge(self, sent: bool) -> bool | None:
        """Return the bridge of this poll, None where it must not be used.

        Args:
            sent: Bridge of the last command that the drive took: a drive that does not report its
                bridge is assumed to follow it.
        """
        reported = self._values.get(BRIDGE)
        if reported is None:
            return None if self._poll.bridge_block else sent
        return reported != 0.0

    def reading(self, arrival_s: float, start_s: float, *, bridge_sent: bool) -> Reading | None:
        """Return the reading that a poll makes, None before every value has been good once.

        Args:
            arrival_s: When the last reply came, monotonic clock.
            start_s: When the poll began.
            bridge_sent: As for `bridge`.
        """
        values = {name: value for name, value in self._values.items() if name != HEARTBEAT}
        self._newest.keep(values, start_s, self._refused)
        return self._newest.reading(arrival_s, bridge=bridge_sent, set_s=start_s)


class DriveHeartbeat:
    """Judges from poll to poll whether a drive's heartbeat advances."""

    def __init__(self, config: Heartbeat) -> None:
        self._watched = config.drive is not None
        self._patience_s = config.drive_timeout_s or 0.0
        self._known: float | None = None
        self._advanced_s = -math.inf

    def forget(self) -> None:
        """Forget the last value: the link was opened again."""
        self._known, self._advanced_s = None, -math.inf

    def beats(self, value: float | None, now_s: float) -> bool | None:
        """Return whether the drive is alive, None while that is not known.

        Args:
            value: Heartbeat of a poll, None where it must not be used.
            now_s: When the poll began, monotonic clock.
        """
        if not self._watched:
            return True
        known, self._known = self._known, value
        if known is None:
            return None  # one value alone shows no life, and neither does the same one again
        if value != known:
            self._advanced_s = now_s
            return True
        return now_s - self._advanced_s <= self._patience_s
