"""Ratios of paired, alternating measurements, with their spread, and whether they say anything."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median, quantiles
from types import FrameType
from typing import Self

LEAST_TURNS = 5
SPREAD_MAX = 0.2
"""Largest distance between the quartiles of a ratio, over its median: of ours to the reference, and
of the reference to itself."""

BUSY = "too busy to tell"


class OutOfTimeError(Exception):
    """A measurement has taken longer than its box."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How long to measure: alternations, and the time of each where it has one."""

    turns: int
    turn_s: float


@contextmanager
def time_box(seconds: float) -> Iterator[None]:
    """End the block after so many seconds, in the main thread.

    Raises:
        OutOfTimeError: It has taken longer.
    """

    def end(_: int, __: FrameType | None) -> None:
        raise OutOfTimeError(f"not measured within {seconds:g} s")

    before = signal.signal(signal.SIGALRM, end)
    before_s, _ = signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.signal(signal.SIGALRM, before)
        signal.setitimer(signal.ITIMER_REAL, before_s)


@dataclass(frozen=True, slots=True)
class Turn:
    """One alternation: ours, between or beside two measurements of the same reference."""

    ours: float
    before: float
    after: float

    @property
    def ratio(self) -> float:
        """Ours over the reference."""
        return 2.0 * self.ours / (self.before + self.after)

    @property
    def null(self) -> float:
        """The reference over itself."""
        return self.after / self.before


def take_turns(
    count: int, ours: Callable[[], float], reference: Callable[[], float]
) -> tuple[Turn, ...]:
    """Measure so many alternations."""
    found = []
    for _ in range(count):
        before = reference()
        found.append(Turn(ours(), before, reference()))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and quartiles."""

    low: float
    median: float
    high: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """Return those of at least two values."""
        return cls(*quantiles(values, n=4, method="inclusive"))


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table, of one build.

    Attributes:
        name: What is measured.
        build: Of the daemon.
        unit: Of ours, absolute.
        against: The reference.
        turns: The alternations.
        most: What is wanted of ours, in its unit; None for no such target.
        most_ratio: What is wanted of the ratio.
        problem: Why there are no turns.
    """

    name: str
    build: str
    unit: str
    against: str
    turns: Sequence[Turn] = ()
    most: float | None = None
    most_ratio: float | None = None
    problem: str = ""

    @property
    def ratio(self) -> Spread:
        """Ours over the reference."""
        return Spread.of(turn.ratio for turn in self.turns)

    @property
    def ours(self) -> float:
        """The median of ours."""
        return median(turn.ours for turn in self.turns)

    @property
    def doubt(self) -> str:
        """Why the row says nothing; empty where it does."""
        if len(self.turns) < LEAST_TURNS:
            return self.problem or f"{len(self.turns)} turns of {LEAST_TURNS}"
        for what, spread in (
            ("the reference over itself", Spread.of(turn.null for turn in self.turns)),
            ("the ratio", self.ratio),
        ):
            if spread.high - spread.low > SPREAD_MAX * spread.median:
                return f"{what} spreads from {spread.low:.2f} to {spread.high:.2f}"
        return ""

    @property
    def cell(self) -> str:
        """Ratio, quartiles, our figure and the verdict, for a table."""
        if self.doubt:
            return self.problem or BUSY
        ratio = self.ratio
        quartiles = f"{ratio.low:.2f}–{ratio.high:.2f}"
        shown = f"{ratio.median:.2f} ({quartiles}), {self.ours:.3g} {self.unit}"
        return f"{shown}{self._verdict}"

    @property
    def _verdict(self) -> str:
        for found, limit, unit in (
            (self.ours, self.most, f" {self.unit}"),
            (self.ratio.median, self.most_ratio, " x"),
        ):
            if limit is not None:
                return f"; {'within' if found <= limit else 'over'} {limit:g}{unit}"
        return ""
