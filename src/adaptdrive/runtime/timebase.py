"""The time base: which half line cycle a frame belongs to, how long one lasts, and ticks take.

A tick is identified by the drive's own counter, unwrapped. A counter that jumps by more or less
than time allows (the drive was restarted, or its frames were lost for long) is anchored anew: its
frame belongs to the next tick.

Without a counter, time counts the half cycles, on a grid that follows the frames slowly. A frame
near the next point of the grid is the next half cycle. One that comes later makes up for those that
were lost, and one that comes with the frame before, as of a pair, is no new half cycle.

A drive that is polled sends no frames by itself: its readings are a fixed number of half cycles
apart, by the clock that polls it, and its ticks are multiples of that number.
"""

import math
from collections import deque
from dataclasses import dataclass

from adaptdrive.safety.frames import SLACK_TICKS, CounterWatch, FrameRate

_LATE_TICKS = 0.75  # without a counter, a frame later than this is taken for the next one

_LATER = 0.08
"""Share of the time passed by which late frames move the grid: more than a rate may be off."""

_EARLIER = 0.16
"""That of early ones: a frame can be late, but not early, so that they show where the grid is."""

_PERIOD_TOLERANCE = 0.02
"""Permitted deviation of the measured half cycle: line frequencies stay within 2 %."""

_MARK_EVERY_TICKS = 60
"""Half cycles between two marks: 0.5 s on a 60 Hz line."""

_MARKS = 20
"""Marks of the measured window: 10 s on a 60 Hz line, compared with which jitter is small."""


class HalfCycles:
    """Unwraps the drive's counter and measures the half cycle.

    Attributes:
        tick_period_s: Half cycle as measured.
        counts: Judge of the drive's counter.
        rate: Rate of its frames.
    """

    def __init__(
        self, modulus: int | None, nominal_tick_s: float, stride: int = 1, stale_s: float = 0.0
    ) -> None:
        """Start without a frame.

        Args:
            modulus: Where the drive's counter wraps, None for a drive without one.
            nominal_tick_s: Half cycle at nominal line frequency.
            stride: Half cycles from one reading to the next, 1 for a drive that sends each.
            stale_s: Longest age of a reading.
        """
        self._stride = stride
        self._modulus = modulus
        self._nominal_s = nominal_tick_s
        self._counter: int | None = None
        self._arrival_s = 0.0
        self._grid_s = 0.0
        self._frame_tick = -1
        self._marks: deque[tuple[int, float]] = deque(maxlen=_MARKS)
        self.tick_period_s = nominal_tick_s
        self.counts = CounterWatch(modulus, nominal_tick_s, stale_s)
        self.rate = FrameRate(nominal_tick_s, stride, counted=modulus is not None)

    @property
    def reading_period_s(self) -> float:
        """Time from one reading to the next."""
        return self._stride * self.tick_period_s

    def following(self, tick: int, skipped: int = 0) -> int:
        """The tick at which the next reading is due, or one that many readings later."""
        return (tick // self._stride + 1 + skipped) * self._stride

    def place(self, counter: int | None, arrival_s: float, latest_tick: int) -> int:
        """The tick that a frame belongs to.

        Args:
            counter: The drive's counter as sent.
            arrival_s: Arrival of the frame, monotonic clock.
            latest_tick: Latest tick that has been run, stand-ins included.
        """
        steps = self._steps(counter, arrival_s)
        stood_in = latest_tick > self._frame_tick
        repeated = self.counts.add(counter, arrival_s, self.tick_period_s)
        self.rate.add(arrival_s, steps, stood_in=stood_in, repeated=repeated)
        if steps is None:
            tick, self._grid_s = self.following(latest_tick), arrival_s
            self._marks.clear()
        elif self._modulus is None:
            tick = self._frame_tick + self._advance_grid(arrival_s) * self._stride
        else:
            tick = self._frame_tick + steps
        self._counter, self._arrival_s, self._frame_tick = counter, arrival_s, tick
        self._measure(tick, arrival_s)
        return tick

    def _advance_grid(self, arrival_s: float) -> int:
        """Move the grid to the point of a frame; return the readings since that of the last one."""
        passed = (arrival_s - self._grid_s) / self.reading_period_s
        readings = max(int(passed >= 1.0 - _LATE_TICKS), int(passed + 1.0 - _LATE_TICKS))
        late_s = (passed - readings) * self.reading_period_s
        passed_s = max(0.0, arrival_s - self._arrival_s)
        moved_s = max(-_EARLIER * passed_s, min(_LATER * passed_s, late_s))
        self._grid_s = arrival_s - late_s + moved_s
        return readings

    def _steps(self, counter: int | None, arrival_s: float) -> int | None:
        """Half cycles since the last frame alone; None when they cannot be determined."""
        if self._frame_tick < 0:
            return None
        elapsed = (arrival_s - self._arrival_s) / self.tick_period_s
        if counter is None or self._counter is None or self._modulus is None:
            return max(1, int(elapsed / self._stride + 1.0 - _LATE_TICKS)) * self._stride
        steps = (counter - self._counter) % self._modulus
        return steps if steps >= 1 and abs(steps - elapsed) <= SLACK_TICKS else None

    def _measure(self, tick: int, arrival_s: float) -> None:
        if self._stride > 1:
            return
        if self._marks and tick - self._marks[-1][0] < _MARK_EVERY_TICKS:
            return
        if self._marks:
            first_tick, first_s = self._marks[0]
            period_s = (arrival_s - first_s) / (tick - first_tick)
            if abs(period_s / self._nominal_s - 1.0) <= _PERIOD_TOLERANCE:
                self.tick_period_s = period_s
        self._marks.append((tick, arrival_s))


# Times that ticks take, and their histograms.


@dataclass(frozen=True, slots=True)
class Quantiles:
    """Median, 99th percentile and maximum of a time, in microseconds."""

    p50: float
    p99: float
    max: float


NO_TIMES = Quantiles(math.nan, math.nan, math.nan)

BINS = 17
"""Bins of a histogram of times: powers of two from below 1 us to 32,768 us and more.

One late tick in a night is seen in it when every report of that minute has long been overwritten.
"""

_LARGEST_US = 1e9
"""Longest time that is counted as it is, 1,000 s, so that infinite ones have a bin."""


def bin_of(time_us: float) -> int:
    """Return the bin of a time in microseconds; anything below 1 us is in the first."""
    return min(int(min(max(0.0, time_us), _LARGEST_US)).bit_length(), BINS - 1)
