"""Overshoot of each half of a square wave, by controller and size of the load."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

_SETTLED_PERIODS = 12
"""Slow periods that a half wave must last before its overshoot counts."""

Case = tuple[str, int | None]
"""Controller and size of the load of a half wave."""


@dataclass(slots=True)
class _Half:
    reference: float
    step: float
    case: Case
    beyond: float = 0.0
    periods: int = 0


class Halves:
    """Collects slow samples and finds the overshoot of each half wave."""

    def __init__(self) -> None:
        self._half: _Half | None = None
        self._reference: float | None = None
        self._found: dict[Case, deque[float]] = {}

    def add(self, reference: float, output: float, controller: str, size: int | None) -> None:
        """Take in one slow period.

        Args:
            reference: Set-point.
            output: In the same unit.
            controller: The controller in force.
            size: Which size the load has, None for one in between.
        """
        case = (controller, size)
        if self._half is not None and case != self._half.case:
            self._close()
        if self._reference is not None and reference != self._reference:
            self._close()
            self._half = _Half(reference, reference - self._reference, case)
        self._reference = reference
        if self._half is not None:
            self._half.periods += 1
            beyond = (output - reference) / self._half.step
            self._half.beyond = max(self._half.beyond, beyond)

    def begin(self, reference: float) -> None:
        """Begin anew, near a reference: something else than a step has moved the output."""
        self._half, self._reference = None, reference

    def overshoot(self, controller: str, size: int) -> float | None:
        """The larger overshoot of the last two half waves of a case, None before the first."""
        found = self._found.get((controller, size))
        return max(found) if found else None

    def _close(self) -> None:
        """End a half wave, at its end or when something is changed; a long one counts."""
        half, self._half = self._half, None
        if half is not None and half.periods >= _SETTLED_PERIODS:
            self._found.setdefault(half.case, deque(maxlen=2)).append(half.beyond)
