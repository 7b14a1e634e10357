"""The frames of a drive: old ones, those of a drive that has started anew, and their rate.

A count that keeps step with the one that is accepted is accepted in its place, if it is a newer
one: it is that of the drive as it was, whatever was lost and however often it has wrapped. One that
does not is accepted once those after it have kept step with it, and not with the one before.

A drive that has started anew must not be driven on. It may do so so quickly that no reading is
missed for long, and the commands of that time have switched it on again before its first report.
Its count then begins at 0. One that may have done so is suspect. If the frames after it keep step
with that from before, it was late, or repeated; frames that waited come at once and are soon over.
If they keep step with the suspect one alone, the drive has started anew.

A drive that hangs, or a gateway, may repeat its last frame for ever, or several of them in turn:
these advance from one to the next, and back. A count that stands, or is behind the newest one, is
therefore that of an old frame. One that has leapt back must keep step for longer than a reading may
be old, before it is accepted.

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
earlier ones. Half cycles that nobody has counted, of a counter that has jumped, begin a new window.
Where the counter jumps all the time, only too many frames are a wrong rate: too few may be lost.

A counter that stands while frames come shows no rate at all: they may be one frame, repeated. How
long it has stood is measured apart.
"""

import math
from collections import deque

from adaptdrive.safety.trips import Trip, TripKind

# Finds old frames, and a drive that has started anew, by the drive's count of half cycles.

SLACK_TICKS = 3
"""Permitted difference of count and time, in half cycles, for jitter of the arrival."""

_DRIFT = 0.04
"""The same per half cycle that passes: line and measured half cycle may be 2 % off each."""

_BEGUN_TICKS = 2 * SLACK_TICKS
"""The same of a count that began at 0 after the frame before, which may have been late itself."""

_PACE_TICKS = 1.0
"""Difference within which the frames after a suspect one keep step with it."""

_SURE_TICKS = 2.5
"""Half cycles after a suspect frame at which frames that had waited are over."""

_OLDER_SHARE = 0.25
"""Share of its range by which a repeated count is older than the newest, at the most."""

_BACK_TICKS = 7.5
"""Half cycles that a counter must keep step after it has leapt back before that is accepted."""

_BACK_SHARE = 1.1
"""The same as a share of the longest age of a reading: frames that are repeated in turn, however
many they are, have stood for longer by then."""

_Count = tuple[int, float]
"""The count of a frame, and its arrival by the monotonic clock."""


class CounterWatch:
    """Compares the count of each frame with those before and with time."""

    def __init__(self, modulus: int | None, tick_s: float, stale_s: float = 0.0) -> None:
        """Start without a frame.

        Args:
            modulus: Where the drive's counter wraps, None for a drive without one.
            tick_s: Half a line cycle at nominal frequency.
            stale_s: Longest age of a reading.
        """
        self._modulus = modulus or 0
        self._tick_s = tick_s
        self._back_ticks = max(_BACK_TICKS, _BACK_SHARE * stale_s / tick_s - 0.5)
        self._seen_s = -math.inf
        self._newest: _Count = (0, -math.inf)
        self._accepted: _Count | None = None
        self._suspect: _Count | None = None
        self._stray: _Count | None = None
        self._cause: Trip | None = None

    @property
    def may_have_restarted(self) -> bool:
        """True while the drive may have started anew."""
        return self._suspect is not None or self._cause is not None

    def add(self, counter: int | None, arrival_s: float, tick_s: float) -> bool:
        """Take the count of a reading; return whether it is an old one.

        Args:
            counter: The drive's counter as sent.
            arrival_s: Arrival of the reading, monotonic clock.
            tick_s: Half a line cycle as measured.
        """
        if counter is None or not self._modulus:
            return False
        self._tick_s = tick_s
        count, quiet = (counter, arrival_s), (arrival_s - self._seen_s) / tick_s
        self._seen_s, before = arrival_s, self._accepted
        self._judge(count)
        if self._accepted != before:
            return False
        if self._is_behind(count) and quiet < 0.5 * self._modulus:  # else it may have come round
            return True
        ahead = (counter - self._newest[0]) % self._modulus
        if ahead <= self._passed(self._newest, count) + SLACK_TICKS:
            self._newest = count
        return False

    def find_cause(self, *, commanded: bool) -> Trip | None:
        """Return the cause of a trip, None for none.

        Args:
            commanded: Whether the last command had the bridge on; else a drive may start anew.
        """
        if not commanded:
            self._cause = None
            if self._suspect is not None:
                self._accept(self._suspect)
        return self._cause

    def _judge(self, count: _Count) -> None:
        """Accept a count that keeps step, or that has kept step with one that did not."""
        accepted, suspect, stray = self._accepted, self._suspect, self._stray
        if accepted is None:
            self._accept(count)
        elif self._off(accepted, count) <= SLACK_TICKS:
            if not self._is_behind(count):
                self._accept(count)
        elif suspect is not None and self._off(suspect, count) <= _PACE_TICKS:
            if self._passed(suspect, count) >= _SURE_TICKS:
                self._note_restart(accepted, suspect)
                self._accept(count)
        elif count[0] <= self._passed(accepted, count) + _BEGUN_TICKS:
            self._suspect, self._stray = count, None
        elif stray is not None and self._off(stray, count) <= _PACE_TICKS:
            sure_ticks = self._back_ticks if self._is_behind(stray) else _SURE_TICKS
            if self._passed(stray, count) >= sure_ticks:
                self._accept(count)
        else:
            self._stray = count

    def _accept(self, count: _Count) -> None:
        """Compare the counts after this one with it alone."""
        self._accepted = self._newest = count
        self._suspect = self._stray = None

    def _is_behind(self, count: _Count) -> bool:
        """Return whether a count is that of an older frame than the newest, or the same again."""
        limit = _OLDER_SHARE * self._modulus
        if self._suspect is not None:  # it may be that of a drive that has started anew
            limit = min(limit, _BEGUN_TICKS + 1)
        return (self._newest[0] - count[0]) % self._modulus < limit

    def _note_restart(self, before: _Count, anew: _Count) -> None:
        due = round(before[0] + self._passed(before, anew)) % self._modulus
        text = f"drive restarted: its half-cycle counter began anew, {anew[0]} where {due} was due"
        self._cause = Trip(TripKind.DRIVE_RESTARTED, text)

    def _off(self, since: _Count, count: _Count) -> float:
        """Return the half cycles by which a count is off, beyond what a line drifts meanwhile."""
        passed = self._passed(since, count)
        off = (count[0] - since[0] - passed) % self._modulus
        return min(off, self._modulus - off) - _DRIFT * abs(passed)

    def _passed(self, since: _Count, count: _Count) -> float:
        """Return the half cycles between the arrivals of two counts."""
        return (count[1] - since[1]) / self._tick_s


# The rate at which a drive that is the clock sends, against the rate that is configured.

_SHORTEST_TICKS = 60
"""Half cycles from which a rate is judged: 0.5 s on a 60 Hz line."""

_LEAST_READINGS = 10
"""Readings from which a rate is judged: of fewer, one that comes late moves it by a tenth."""

_BLOCKS = 4
"""Blocks of half the shortest window over which the rate is measured: 1 s on a 60 Hz line."""

_LASTING_TICKS = 120
"""Time for which a rate must be wrong: longer than frames stay late that came at once, 1 s."""

_TOLERANCE = 0.06
"""The line may be off by 2 %; 50 Hz on a configuration for 60 Hz is off by 17 %."""

_JITTER_TICKS = 2.0
"""Jitter that the least late readings of two halves of the window may have left, together."""

_THIN_SHARE = 0.9
"""Share of readings that came only after a stand-in tick, for which the drive sends too seldom."""


_Least = tuple[float, int]
"""Least lateness of some readings, and the count at which it occurred, both in half cycles."""

_Ends = tuple[_Least, _Least]
"""That of the earlier and of the later half of a window."""

_UNKNOWN: _Least = (math.inf, 0)

_Levels = deque[_Least]
"""Those of the last blocks of readings, the present one last."""


def verdict_ticks(stride: int) -> int:
    """Return the half cycles after which the rate of a steady drive is known, or named as wrong.

    Args:
        stride: Half cycles from one reading to the next.
    """
    return _BLOCKS * _block_size(stride) * stride + _LASTING_TICKS


def _block_size(stride: int) -> int:
    """Return the readings of half the shortest window."""
    return max(_LEAST_READINGS, _SHORTEST_TICKS // stride) // 2


class FrameRate:
    """Measures the rate of a drive's readings.

    Attributes:
        judged: Whether enough readings have come at the right rate.
        cause: The wrong rate, once it has lasted.
        standing_s: Time for which no reading has come with a newer count, 0 while it moves.
    """

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
        self._block_size = _block_size(stride)
        self._by_count, self._by_reading = _levels(), _levels()
        self._thin: deque[bool] = deque(maxlen=_BLOCKS * self._block_size)
        self._began_s: float | None = None
        self._ticks = self._readings = 0
        self._wrong_since_s: float | None = None
        self._moved_s = math.inf
        self.judged = False
        self.cause: Trip | None = None
        self.standing_s = 0.0

    def add(
        self, arrival_s: float, steps: int | None, *, stood_in: bool, repeated: bool = False
    ) -> None:
        """Take one reading, and judge the rate anew at the end of each block.

        Args:
            arrival_s: Arrival of its clocking frame, monotonic clock.
            steps: Half cycles since the reading before, None where they cannot be known.
            stood_in: Whether a stand-in tick had to run before it.
            repeated: Whether it is an old reading, by its count.
        """
        self._moved_s = self._moved_s if repeated else arrival_s
        self.standing_s = arrival_s - self._moved_s
        if self._began_s is None:
            self._began_s = arrival_s
            return
        self._readings += 1
        if steps is None:  # half cycles that nobody has counted
            self._by_count = _levels()
        else:
            self._ticks += steps
        passed = (arrival_s - self._began_s) / self._tick_s
        _extend(self._by_count, passed, self._ticks)
        _extend(self._by_reading, passed, self._readings * self._stride)
        self._thin.append(stood_in and (steps is None or steps > self._stride))
        if self._readings % self._block_size == 0:
            self._judge(arrival_s)
            self._by_count.append(_UNKNOWN)
            self._by_reading.append(_UNKNOWN)

    def _judge(self, now_s: float) -> None:
        """Name a rate that has been wrong for long enough."""
        counted, sent = _ends(self._by_count), _ends(self._by_reading)
        if sent is None:
            return
        wrong = self._problem(counted, sent)
        self.judged = counted is not None and wrong is None
        if wrong is None:
            self._wrong_since_s = self.cause = None
        elif self._wrong_since_s is None:
            self._wrong_since_s = now_s
        elif now_s - self._wrong_since_s >= _LASTING_TICKS * self._tick_s:
            self.cause = wrong

    def _problem(self, counted: _Ends | None, sent: _Ends) -> Trip | None:
        if counted is None:
            fits = sent[1][0] >= sent[0][0] or _fits(*sent)  # lost readings are no sign
        else:
            fits = _fits(*counted) or (not self._counted and _fits(*sent))
        thin = sum(self._thin) > _THIN_SHARE * len(self._thin)
        if fits and not thin:
            return None
        expected_Hz = 1.0 / (self._stride * self._tick_s)
        if counted is None or not _fits(*sent):
            found = f"sends {_share(*sent) * expected_Hz:.4g} readings/s"
        else:
            found = f"counts {_share(*counted) * expected_Hz:.4g} half cycles/s"
        return Trip(
            TripKind.FRAME_RATE,
            f"frame rate: the drive {found}, expected {expected_Hz:.4g}/s: look at "
            "drive.line_frequency_Hz, bus.clock and bus.clock_ticks",
        )


def _levels() -> _Levels:
    return deque([_UNKNOWN], maxlen=_BLOCKS)


def _extend(levels: _Levels, passed: float, count: int) -> None:
    levels[-1] = min(levels[-1], (passed - count, count))


def _ends(levels: _Levels) -> _Ends | None:
    """Return the least of the earlier and of the later half; None of fewer than two."""
    ordered, half = list(levels), len(levels) // 2
    return (min(ordered[:half]), min(ordered[-half:])) if half else None


def _fits(early: _Least, late: _Least) -> bool:
    """Return whether the configured rate explains how late two readings were."""
    return abs(late[0] - early[0]) <= _TOLERANCE * (late[1] - early[1]) + _JITTER_TICKS


def _share(early: _Least, late: _Least) -> float:
    """Return the rate between two readings as a share of the configured one."""
    counted = late[1] - early[1]
    took_ticks = counted + late[0] - early[0]
    return counted / took_ticks if took_ticks > 0.0 else math.inf
