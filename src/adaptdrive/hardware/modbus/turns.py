"""Order in which the blocks of a sensor link are asked for.

A missing reply keeps the link busy for a whole time-out, on a serial line for three. So a block
whose last reply is missing comes after those that answer, and waits where the cycle is used up. A
block that stays silent until its values are too old to be used is asked for seldom.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from adaptdrive.hardware.binding import Source
from adaptdrive.hardware.polled.capacity import Exchange
from adaptdrive.hardware.polled.mapping import Named

SELDOM_CYCLES = 10
"""Cycles between two requests to silent blocks that do not fit: one in ten may be late."""


@dataclass(frozen=True, slots=True)
class SensorBlock:
    """Registers that are asked for at once, and what is taken from them."""

    exchange: Exchange
    sources: tuple[Source[Named], ...]


@dataclass(slots=True, eq=False)
class Turn:
    """A block with what became of its requests on an open link.

    Attributes:
        block: The block.
        misses: Replies that are missing in a row.
        asked: Number of the cycle in which it was asked for last.
    """

    block: SensorBlock
    misses: int = 0
    asked: int = 0

    @property
    def device_id(self) -> int | None:
        """The device that has the block."""
        return self.block.exchange.device_id


class Turns:
    """The blocks of one open link."""

    def __init__(self, blocks: tuple[SensorBlock, ...], patience: int) -> None:
        """Ask for every block in the first cycle.

        Args:
            blocks: The blocks in the order in which they are asked for while all answer.
            patience: Replies missing in a row after which a block is silent.
        """
        self._turns = [Turn(block) for block in blocks]
        self._patience = patience
        self._cycle = 0
        self._tried = 0
        self._missing: set[int | None] = set()

    @property
    def all_missed(self) -> bool:
        """True if no block gave a reply when it was asked for last."""
        return all(turn.misses for turn in self._turns)

    def due(self, left_s: Callable[[], float], miss_s: float) -> Iterator[Turn]:
        """Yield what is asked for in a cycle; each must be noted before the next one is taken.

        Args:
            left_s: Returns the time that is left of the cycle, in s.
            miss_s: Time for which a missing reply keeps the link busy, in s.
        """
        self._cycle += 1
        self._missing.clear()
        awake = [turn for turn in self._turns if turn.misses < self._patience]
        for turn in sorted(awake, key=lambda one: one.misses):
            if not self._is_doubtful(turn) or left_s() > 0.0:
                yield turn
        due = not awake or self._cycle - self._tried >= SELDOM_CYCLES
        silent = self._next_silent()
        if silent is not None and ((due and not self._missing) or left_s() >= miss_s):
            self._tried = self._cycle
            yield silent

    def note(self, turn: Turn, *, answered: bool) -> None:
        """Note what became of a request; a silent device that answers is awake as a whole."""
        turn.asked = self._cycle
        if not answered:
            turn.misses += 1
            self._missing.add(turn.device_id)
            return
        found = turn.misses >= self._patience
        for one in self._turns:
            if one is turn or (found and one.device_id == turn.device_id):
                one.misses = 0

    def _is_doubtful(self, turn: Turn) -> bool:
        """Return whether a reply is missing in this cycle and may be missing here, too."""
        return bool(self._missing) and (turn.misses > 0 or turn.device_id in self._missing)

    def _next_silent(self) -> Turn | None:
        """Return the block that has waited longest of the silent device that has waited longest."""
        silent = [turn for turn in self._turns if turn.misses >= self._patience]
        asked: dict[int | None, int] = {}
        for turn in silent:
            asked[turn.device_id] = max(turn.asked, asked.get(turn.device_id, 0))
        return min(silent, key=lambda one: (asked[one.device_id], one.asked), default=None)
