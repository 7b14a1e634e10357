"""Set-point waveforms: pure functions of the time since they were started."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum


class Shape(StrEnum):
    """Shapes a set-point can follow."""

    SQUARE = "square"
    SINE = "sine"
    TRIANGLE = "triangle"


@dataclass(frozen=True, slots=True)
class Waveform:
    """A periodic set-point; the high half comes first.

    Attributes:
        shape: Form of one period.
        low: Lowest value, unit of the output.
        high: Highest value, unit of the output.
        period_s: Length of one period.
    """

    shape: Shape
    low: float
    high: float
    period_s: float

    def value(self, elapsed_s: float) -> float:
        """The set-point `elapsed_s` after the waveform was started."""
        phase = math.fmod(elapsed_s, self.period_s) / self.period_s
        return self.low + (self.high - self.low) * _LEVELS[self.shape](phase)

    def told(self, tick: int) -> str:
        """Facts that the controller is told of a waveform that was started at a tick."""
        return f"{self.shape} {self.low!r} {self.high!r} {self.period_s!r} {tick}"


def heard(told: str) -> tuple[Waveform, int]:
    """Return the waveform that the controller is told of, and the tick of its start."""
    shape, low, high, period_s, tick = told.split()
    return Waveform(Shape(shape), float(low), float(high), float(period_s)), int(tick)


def _square(phase: float) -> float:
    return 1.0 if phase < 0.5 else 0.0


def _sine(phase: float) -> float:
    return 0.5 + 0.5 * math.sin(2.0 * math.pi * phase)


def _triangle(phase: float) -> float:
    return 1.0 - abs(1.0 - math.fmod(2.0 * phase + 0.5, 2.0))


_LEVELS = {Shape.SQUARE: _square, Shape.SINE: _sine, Shape.TRIANGLE: _triangle}
