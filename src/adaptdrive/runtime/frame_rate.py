"""The rate at which a drive that is the clock sends, against the rate that is configured.

The controller takes each half cycle for 1/(2 · line frequency). A drive on another line, or a
clocking message that comes more or less often, would run its model too fast or too slow, without
any other sign.

A lost frame, a burst of them, jitter and a restarted drive are no wrong rate. The half cycles that
the drive's own counter has counted are compared with the time that they took, however many frames
were lost. Without a counter either the frames or the half cycles that time has counted must fit:
the first survives jitter, the second lost frames.
"""

from __future__ import annotations

from collections import deque

_SHORTEST_TICKS = 60
"""Half cycles from which a rate is judged: 0.5 s on a 60 Hz line."""

_LEAST_READINGS = 10
"""Readings from which a rate is judged: of fewer, one that comes late moves it by a tenth."""

_WINDOWS = 4
"""Window over which the rate is measured, in multiples of the shortest: 2 s on a 60 Hz line."""

_TOLERANCE = 0.06
"""The line may be off by 2 %; 50 Hz on a configuration for 60 Hz is off by 17 %."""

_JITTER_TICKS = 4.0
"""Jitter of the first and the last arrival of a window, together."""

_THIN_SHARE = 0.9
"""Share of readings that came only after a stand-in tick, for which the drive sends too seldom."""


class _Mark:
    """Counts up to one reading: its time, half cycles, and late readings."""

    __slots__ = ("arrival_s", "thin", "ticks")

    def __init__(self, arrival_s: float, ticks: int, thin: int) -> None:
        self.arrival_s = arrival_s
        self.ticks = ticks
        self.thin = thin


class FrameRate:
    """Measures the rate of a drive's readings."""

    def __init__(self, tick_s: float, stride: int, *, counted: bool) -> None:
        """Start without a reading.

        Args:
            tick_s: Half a line cycle at nominal frequency.
            stride: Half cycles from one reading to the next.
            counted: Whether the drive counts its half cycles.
        """
        self._tick_s = tick_s
        self._stride = stride
        self._counted = counted
        self._least = max(_LEAST_READINGS, _SHORTEST_TICKS // stride)
        self._marks: deque[_Mark] = deque(maxlen=_WINDOWS * self._least + 1)
        self._wrong = 0
        self.cause: str | None = None

    @property
    def judged(self) -> bool:
        """True once enough readings have come at the right rate.

        Within one and a half of the shortest window a rate is either judged or named in `cause`.
        """
        return len(self._marks) > self._least and not self._wrong

    def add(self, arrival_s: float, steps: int | None, *, stood_in: bool) -> None:
        """Take one reading, and judge the rate anew.

        Args:
            arrival_s: Arrival of its clocking frame, monotonic clock.
            steps: Half cycles since the reading before, None where they cannot be known.
            stood_in: Whether a stand-in tick had to run before it.
        """
        if not self._marks:
            self._marks.append(_Mark(arrival_s, 0, 0))
            return
        last = self._marks[-1]
        if steps is None:
            passed = (arrival_s - last.arrival_s) / self._tick_s / self._stride
            steps = max(1, round(passed)) * self._stride
        thin = last.thin + (stood_in and steps > self._stride)
        self._marks.append(_Mark(arrival_s, last.ticks + steps, thin))
        self._judge()

    def _judge(self) -> None:
        """Name a rate that has been wrong for half of the shortest window."""
        wrong = self._problem()
        self._wrong = 0 if wrong is None else self._wrong + 1
        self.cause = wrong if 2 * self._wrong > self._least else None

    def _problem(self) -> str | None:
        first, last, readings = self._marks[0], self._marks[-1], len(self._marks) - 1
        if readings < self._least or last.arrival_s <= first.arrival_s:
            return None
        took_ticks = (last.arrival_s - first.arrival_s) / self._tick_s
        share = (last.ticks - first.ticks) / took_ticks
        frames = readings * self._stride / took_ticks
        tolerance = _TOLERANCE + _JITTER_TICKS / (readings * self._stride)
        fits = abs(share - 1.0) <= tolerance
        if not self._counted:
            fits = fits or abs(frames - 1.0) <= tolerance
        thin = last.thin - first.thin > _THIN_SHARE * readings
        if fits and not thin:
            return None
        return self._text(share, frames, by_frames=abs(frames - 1.0) > tolerance)

    def _text(self, share: float, frames: float, *, by_frames: bool) -> str:
        expected_Hz = 1.0 / (self._stride * self._tick_s)
        if by_frames:
            found = f"the drive sends {frames * expected_Hz:.4g} readings/s"
        else:
            found = f"the drive counts {share * expected_Hz:.4g} half cycles/s"
        return (
            f"frame rate: {found}, expected {expected_Hz:.4g}/s: look at drive.line_frequency_Hz, "
            "bus.clock and bus.clock_ticks"
        )
