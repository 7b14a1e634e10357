"""Result of a replay, and its text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Difference:
    """The values recorded and replayed at one tick."""

    tick: int
    recorded: Mapping[str, Any]
    replayed: Mapping[str, Any]

    def __str__(self) -> str:
        return f"at tick {self.tick}: recorded {_text(self.recorded)}; now {_text(self.replayed)}"


@dataclass(frozen=True, slots=True)
class Gap:
    """Ticks that were run and not recorded.

    Attributes:
        before_tick: First recorded tick after them.
        missing: How many; negative where the record goes back.
    """

    before_tick: int
    missing: int

    def __str__(self) -> str:
        return f"{self.missing} before tick {self.before_tick}"


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """Result of a replay.

    Attributes:
        session: Name of the session.
        ticks: Fast ticks replayed.
        slow_steps: Slow steps replayed.
        differing_commands: Commands that are not the recorded ones to the last bit.
        first_command: The first of them.
        largest: Largest difference by quantity of the command; only quantities that differ.
        differing_decisions: Slow steps that came out differently.
        first_decision: The first of them.
        gaps: Where ticks are missing from the record.
        unmatched: Slow indices that took effect in the record, but had no decision in the replay.
    """

    session: str
    ticks: int
    slow_steps: int
    differing_commands: int
    first_command: Difference | None
    largest: Mapping[str, float]
    differing_decisions: int
    first_decision: Difference | None
    gaps: tuple[Gap, ...]
    unmatched: tuple[int, ...]

    @property
    def exact(self) -> bool:
        """True when the record is whole and every command came out bit-equal."""
        return not (self.gaps or self.unmatched or self.differing_commands)

    def __str__(self) -> str:
        lines = [f"{self.session}: replayed {self.ticks} ticks and {self.slow_steps} slow steps"]
        lines += self._told_gaps() + self._told_commands() + self._told_decisions()
        return "\n".join(lines)

    def _told_gaps(self) -> list[str]:
        lines = []
        if self.gaps:
            shown = ", ".join(map(str, self.gaps[:5])) + (", ..." if len(self.gaps) > 5 else "")
            lines.append(f"cannot be exact, the record lacks ticks: {shown}")
        if self.unmatched:
            count, first = len(self.unmatched), self.unmatched[0]
            lines.append(f"no decision to apply for {count} slow steps, the first at k = {first}")
        return lines

    def _told_commands(self) -> list[str]:
        if self.first_command is None:
            return ["every command is bit-equal"]
        share = f"{self.differing_commands} of {self.ticks} commands differ"
        return [share, f"first {self.first_command}", f"largest difference {_text(self.largest)}"]

    def _told_decisions(self) -> list[str]:
        if self.first_decision is None:
            return []
        share = f"{self.differing_decisions} of {self.slow_steps} slow steps differ"
        return [share, f"first {self.first_decision}"]


def _text(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value!r}" for name, value in values.items())
