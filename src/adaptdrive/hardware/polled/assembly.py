"""Putting the blocks of one poll together: a reading, or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Sequence

from adaptdrive.config.modbus import Heartbeat
from adaptdrive.hardware.binding import BRIDGE, Source
from adaptdrive.hardware.fault_latch import FaultLatch
from adaptdrive.hardware.polled.capacity import Block
from adaptdrive.hardware.polled.mapping import HEARTBEAT, Named, Poll, explain, value_in, word_in
from adaptdrive.hardware.port import Reading, composed, confirming

STANDS_STILL = "the drive's heartbeat register stands still: its controller hangs"


class PollAssembly:
    """Collects the values of the blocks of a poll.

    Attributes:
        faults: Fault word of the drive.
        raw: Registers of each block that was read last.
    """

    def __init__(self, poll: Poll) -> None:
        self._poll = poll
        self._values: dict[str, float] = {}
        self._handed_out: Reading | None = None
        self.faults = FaultLatch(poll.faults)
        self.raw: dict[Block, list[int]] = {}
        self._refused: list[str] = []

    @property
    def heartbeat(self) -> float | None:
        """Heartbeat of the drive in this poll, None where it must not be used."""
        return self._values.get(HEARTBEAT)

    @property
    def refusal(self) -> str:
        """Reason why values of the poll must not be used, empty where all may be."""
        if not self._refused:
            return ""
        more = f", and {len(self._refused) - 1} more" if len(self._refused) > 1 else ""
        return f"{self._refused[0]}{more}"

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
            if source.quantity in self._poll.faults:
                self.faults.see(value, source.quantity)
            if value is not None:
                self._values[source.quantity] = value
            else:
                self._refused.append(explain(source, block, words))

    def reading(
        self, arrival_s: float, start_s: float, *, bridge_sent: bool, stopped: bool
    ) -> Reading | None:
        """Return the reading of a poll, None for refused values of a driven drive.

        A drive at rest may confirm its stop although its measurements are refused: it has the
        reading before with the bridge of this poll, even if that came over a link before.

        Args:
            arrival_s: When the last reply came, monotonic clock.
            start_s: When the poll began.
            bridge_sent: Bridge of the last command that the drive took: a drive that does not
                report its bridge is assumed to follow it.
            stopped: Whether the safe command is in force.
        """
        reading = self._stop(arrival_s, start_s) if self._refused and stopped else None
        if not self._refused:
            bridge = self._values.get(BRIDGE, bridge_sent)
            reading = composed(
                self._values,
                self._poll.other,
                self.faults,
                arrival_s=arrival_s,
                oldest_s=start_s,
                bridge=bridge != 0,
            )
        self._handed_out = reading or self._handed_out
        return reading

    def _stop(self, arrival_s: float, start_s: float) -> Reading | None:
        """Return the last reading with the bridge of this poll."""
        last, powered = self._handed_out, self.powered_beside_refused
        if last is None or powered is None:
            return None
        return confirming(last, self.faults, arrival_s=arrival_s, bridge=powered, bridge_s=start_s)

    @property
    def powered_beside_refused(self) -> bool | None:
        """The bridge of a poll with refused values, None where it must not be used."""
        for block, sources in self._poll.reads:
            for source in sources:
                if source.quantity == BRIDGE:
                    word = word_in(source, block, self.raw[block])
                    return None if word is None else word != 0
        return None


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
