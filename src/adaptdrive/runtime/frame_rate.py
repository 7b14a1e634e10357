"""The rate at which a drive that is the clock sends, against the rate that is configured.

The controller takes each half cycle for 1/(2 · line frequency). A drive on another line, or a
clocking message that comes more or less often, would run its model too fast or too slow, without
any other sign.

A lost frame, a burst of them, jitter, a stall and a restarted drive are no wrong rate. The half
cycles that the drive's own counter has counted are compared with the time that they took, however
many frames were lost. Without a counter either the frames or the half cycles that time has counted
must fit: the first survives jitter, the second lost frames.

A frame can be late, but not early. Of each block of readings only the one that was least late
against the configured rate counts, so that frames which a stalled bus delivers at once do not look
like a fast drive; a rate that is wrong moves the least of the later blocks against that of the
earlier ones.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

_SHORTEST_TICKS = 60
"""Half cycles from which a rate is judged: 0.5 s on a 60 Hz line."""

_LEAST_READINGS = 10
"""Readings from which a rate is judged: of fewer, one that comes late moves it by a tenth."""

_BLOCKS = 8
"""Blocks of half the shortest window over which the rate is measured: 2 s on a 60 Hz line."""

_TOLERANCE = 0.06
"""The line may be off by 2 %; 50 Hz on a configuration for 60 Hz is off by 17 %."""

_JITTER_TICKS = 2.0
"""Jitter that the least late readings of two blocks may have left."""

_THIN_SHARE = 0.9
"""Share of readings that came only after a stand-in tick, for which the drive sends too seldom."""


class _Block:
    """Some readings in a row, by the counts before them and how late they were.

    Attributes:
        ticks: Half cycles counted before the block.
        readings: Readings before the block.
        excess_ticks: Least lateness against the counted half cycles.
        lag_ticks: Least lateness against the readings.
        thin: Readings that came only after a stand-in tick.
    """

    __slots__ = ("excess_ticks", "lag_ticks", "readings", "thin", "ticks")

    def __init__(self, ticks: int, readings: int) -> None:
        self.ticks = ticks
        self.readings = readings
        self.excess_ticks = self.lag_ticks = math.inf
        self.thin = 0


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
        self._block_size = max(_LEAST_READINGS, _SHORTEST_TICKS // stride) // 2
        self._blocks: deque[_Block] = deque(maxlen=_BLOCKS)
        self._block = _Block(0, 0)
        self._began_s = self._arrival_s = math.nan
        self._ticks = self._readings = self._wrong = 0
        self.cause: str | None = None

    @property
    def judged(self) -> bool:
        """True once enough readings have come at the right rate.

        Within one and a half of the shortest window a rate is either judged or named in `cause`.
        """
        return len(self._blocks) > 1 and not self._wrong

    def add(self, arrival_s: float, steps: int | None, *, stood_in: bool) -> None:
        """Take one reading, and judge the rate anew at the end of each block.

        Args:
            arrival_s: Arrival of its clocking frame, monotonic clock.
            steps: Half cycles since the reading before, None where they cannot be known.
            stood_in: Whether a stand-in tick had to run before it.
        """
        if math.isnan(self._began_s):
            self._began_s = self._arrival_s = arrival_s
            return
        steps = self._counted_steps(arrival_s, steps)
        self._arrival_s = arrival_s
        self._ticks += steps
        self._readings += 1
        self._extend(arrival_s, thin=stood_in and steps > self._stride)
        if self._readings % self._block_size == 0:
            self._blocks.append(self._block)
            self._block = _Block(self._ticks, self._readings)
            self._judge()

    def _counted_steps(self, arrival_s: float, steps: int | None) -> int:
        """Half cycles since the reading before, by time where the drive does not say."""
        if steps is not None:
            return steps
        passed = (arrival_s - self._arrival_s) / self._tick_s / self._stride
        return max(1, round(passed)) * self._stride

    def _extend(self, arrival_s: float, *, thin: bool) -> None:
        block, passed = self._block, (arrival_s - self._began_s) / self._tick_s
        block.excess_ticks = min(block.excess_ticks, passed - self._ticks)
        block.lag_ticks = min(block.lag_ticks, passed - self._readings * self._stride)
        block.thin += thin

    def _judge(self) -> None:
        """Name a rate that has been wrong at the end of two blocks in a row."""
        wrong = self._problem() if len(self._blocks) > 1 else None
        self._wrong = 0 if wrong is None else self._wrong + 1
        self.cause = wrong if self._wrong > 1 else None

    def _problem(self) -> str | None:
        blocks = list(self._blocks)
        half = len(blocks) // 2
        early, late = blocks[:half], blocks[-half:]
        counted = late[0].ticks - early[0].ticks
        share = _share(counted, [b.excess_ticks for b in early], [b.excess_ticks for b in late])
        expected = (late[0].readings - early[0].readings) * self._stride
        frames = _share(expected, [b.lag_ticks for b in early], [b.lag_ticks for b in late])
        tolerance = _TOLERANCE + _JITTER_TICKS / expected
        fits = abs(share - 1.0) <= tolerance
        if not self._counted:
            fits = fits or abs(frames - 1.0) <= tolerance
        thin = sum(b.thin for b in blocks) > _THIN_SHARE * len(blocks) * self._block_size
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


def _share(counted: int, early_ticks: Iterable[float], late_ticks: Iterable[float]) -> float:
    """Return a rate as a share of the configured one; 1 for frames that came all at once.

    Args:
        counted: Half cycles from the early to the late blocks.
        early_ticks: Least lateness of each early block, in half cycles of the configured rate.
        late_ticks: That of each late block.
    """
    took_ticks = counted + min(late_ticks) - min(early_ticks)
    return counted / took_ticks if took_ticks > 0.0 else 1.0
