"""Pace at which the blocks of a command are written: what a drive holds already may wait."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from adaptdrive.config.cadence import DAY_S
from adaptdrive.hardware.binding import BRIDGE, Sink
from adaptdrive.hardware.polled.blocks import Block
from adaptdrive.hardware.polled.mapping import Named, Poll


class WritePace:
    """Keeps what the drive has acknowledged of each block, and since when."""

    def __init__(self, poll: Poll, clock: Callable[[], float]) -> None:
        """Let each block be written.

        Args:
            poll: The blocks of a command.
            clock: Monotonic clock, in s.
        """
        self._clock = clock
        self._interval_s = poll.interval_s
        self._least_s = {block: _least_s(sinks) for block, sinks in poll.writes}
        self._switches = {block for block, sinks in poll.writes if has_switch(sinks)}
        self._held: dict[Block, list[int]] = {}
        self._written_s: dict[Block, float] = {}

    def forget(self) -> None:
        """Begin a link: the drive may hold other registers; the times of the writes stay."""
        self._held.clear()

    def is_due(self, block: Block, words: list[int]) -> bool:
        """Return whether a block is written now.

        Args:
            block: The block.
            words: Its registers.
        """
        age_s = self._clock() - self._written_s.get(block, -math.inf)
        limited = self._least_s[block]
        if self._held.get(block) == words:
            return not limited and age_s >= self._interval_s
        return age_s >= limited or block in self._switches

    def doubt(self, block: Block) -> None:
        """Note that a block is about to be written: until the reply nobody knows what it holds."""
        self._held.pop(block, None)
        self._written_s[block] = self._clock()

    def note(self, block: Block, words: list[int]) -> None:
        """Note that the drive has acknowledged a block."""
        self._held[block] = words
        self._written_s[block] = self._clock()


def has_switch(sinks: Iterable[Sink[Named]]) -> bool:
    """Return whether a block has the switch of the bridge, by which a stop begins."""
    return any(sink.name == BRIDGE and sink.factor != 0.0 for sink in sinks)


def _least_s(sinks: Iterable[Sink[Named]]) -> float:
    """Return the least time between two writes, 0 for registers that endure any number."""
    limits = (one.item.register.write_limit for one in sinks)
    return max((DAY_S / limit for limit in limits if limit is not None), default=0.0)
