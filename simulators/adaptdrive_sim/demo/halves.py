"""Overshoot of each half of the square wave, by controller and number of disks."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

_SETTLED_PERIODS = 12
"""Slow periods that a half wave must last before its overshoot counts."""


@dataclass(frozen=True, slots=True)
class HalfCase:
    """Controller and load of a half wave."""

    controller: str
    disks: int


@dataclass(slots=True)
class _Half:
    reference: float
    step: float
    case: HalfCase
    beyond: float = -math.inf
    periods: int = 0

    @property
    def overshoot(self) -> float:
        return max(0.0, self.beyond / abs(self.step))

    def extend(self, output: float) -> None:
        self.periods += 1
        beyond = math.copysign(1.0, self.step) * (output - self.reference)
        self.beyond = max(self.beyond, beyond)


class Halves:
    """Collects slow samples and finds the overshoot of each half wave.

    Attributes:
        edges: Steps of the reference so far.
        periods: Slow periods since the last step.
    """

    def __init__(self) -> None:
        self.edges = 0
        self.periods = 0
        self._half: _Half | None = None
        self._reference: float | None = None
        self._found: dict[HalfCase, deque[float]] = {}

    def add(self, reference: float, output: float, controller: str, disks: int) -> None:
        """Take in one slow period.

        Args:
            reference: Set-point.
            output: Speed, in the same unit.
            controller: The controller in force.
            disks: Disks on the shaft.
        """
        case = HalfCase(controller, disks)
        if self._half is not None and case != self._half.case:
            self._close()
        if self._reference is not None and reference != self._reference:
            self._close()
            self._half = _Half(reference, reference - self._reference, case)
            self.edges += 1
            self.periods = 0
        self._reference = reference
        self.periods += 1
        if self._half is not None:
            self._half.extend(output)

    def overshoot(self, controller: str, disks: int) -> float | None:
        """The larger overshoot of the last two half waves of a case, None before the first."""
        found = self._found.get(HalfCase(controller, disks))
        return max(found) if found else None

    def _close(self) -> None:
        """End a half wave, at its end or when something is changed; a long one counts."""
        half, self._half = self._half, None
        if half is not None and half.periods >= _SETTLED_PERIODS:
            self._found.setdefault(half.case, deque(maxlen=2)).append(half.overshoot)
