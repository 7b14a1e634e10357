"""Whether a drive that is driven may have stopped, and whether anyone else drives it.

A drive that stopped while nothing came from it is not energised afterwards. Two masters must not
drive one load.
"""

import math
from collections.abc import Callable

from adaptdrive.safety.facts import Reading
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip, TripKind

# Notices a drive that has stopped by itself: it must not be driven on as if it had not.

_SLACK_S = 1e-6
"""Rounding of sums of half cycles: the last one within the grace is not yet a stop."""


class BridgeWatch:
    """Finds a drive that reports its bridge off although it was commanded on."""

    def __init__(self, timing: Timing, *, reported: bool = True, cycle_s: float = 0.0) -> None:
        """Watch from the first half cycle.

        Args:
            timing: Times of the drive.
            reported: Whether the drive reports its bridge: after a silence nothing else shows that
                it has not stopped.
            cycle_s: Time from one such report to the next, 0 where each reading has one, infinite
                where it is not known.
        """
        self._reading_s = timing.reading_s
        self._grace_s = timing.switched_on_s
        self._on_s = timing.unseen_s
        self._hidden_s = timing.hidden_s(cycle_s)
        self._gap_limit_s = timing.unwatched_s
        self._silent_limit_s = timing.silent_s
        self._mute_limit_s = timing.unreported_s(cycle_s)
        self._reported = reported
        self._off_s: float | None = None
        self._due_s = math.inf
        self._commanded_s = math.inf
        self._lingers = False
        self._been_on = False
        self._bounced_s: float | None = None
        self._gap_s = self._silent_s = 0.0
        self._gap_end_s = self._silence_end_s = -math.inf

    def find_cause(
        self, reading: Reading, *, commanded: bool, due: bool, unwatched_s: float, now_s: float
    ) -> Trip | None:
        """Return the cause of a trip, None for none.

        Only reports of the drive count: one that has fallen silent is stale, not off. A bridge that
        has come on by command and is off is a stop at once; one that has not been on yet has its
        time to switch. In that time one report of off after one of on may be a contact that
        bounces: the next report decides. A report from before the command shows nothing of what
        follows it.

        A drive may have stopped while this process did not run, or without a report of its
        bridge, whatever else came: a report from before the end of that time shows nothing of it.

        Args:
            reading: The newest reading.
            commanded: Whether the last command had the bridge on.
            due: Whether a bridge that has not been on yet must come on; not while a drive starts.
            unwatched_s: Time since the last look.
            now_s: Monotonic time of this look.
        """
        if unwatched_s > self._gap_limit_s:
            self._gap_s, self._gap_end_s = max(self._gap_s, unwatched_s), now_s
        self._note_silence(reading, now_s)
        self._due_s = min(self._due_s, now_s) if commanded and due else math.inf
        if not commanded:
            self._rest(bridge=reading.bridge)
            return None
        self._commanded_s = min(self._commanded_s, now_s)
        if reading.bridge:
            self._note_on(reading)
            return None
        self._lingers = False
        if self._been_on and self._may_bounce(reading.bridge_reported_s):
            return None
        if not self._been_on and not self._is_overdue(reading.bridge_reported_s):
            return None
        text = f"drive stopped: its bridge is off although it was commanded on{self._hidden}"
        return Trip(TripKind.DRIVE_STOPPED, text)

    def must_report(self, unwatched_s: float) -> bool:
        """Return whether a drive that may have stopped by itself must report before a command.

        Never one that does not report its bridge: the wait itself would let it stop.

        Args:
            unwatched_s: Time since the last look.
        """
        unheard_s = max(self._gap_s, self._silent_s, unwatched_s)
        hidden = self._reported and self._been_on and unheard_s > self._on_s
        return hidden or self._bounced_s is not None

    def hides_stop(self, unwatched_s: float) -> bool:
        """Return whether a command that was late on the bus may have hidden a stop.

        Args:
            unwatched_s: Time from the last look until after that command.
        """
        return self.must_report(unwatched_s) and unwatched_s > self._hidden_s

    def _rest(self, *, bridge: bool) -> None:
        """Begin anew with a drive that is commanded off; its bridge may still be on."""
        self._off_s, self._been_on, self._lingers = None, False, bridge
        self._bounced_s = None
        self._commanded_s = math.inf
        self._gap_s = self._silent_s = 0.0

    def _note_on(self, reading: Reading) -> None:
        """Note a bridge that is on, by this command unless it still is by the one before."""
        self._off_s = self._bounced_s = None
        reported_s = reading.bridge_reported_s
        switched = not self._lingers or reported_s - self._commanded_s > self._grace_s
        self._been_on = self._been_on or switched
        if reported_s > self._gap_end_s:
            self._gap_s = 0.0
        if _bridge_report_s(reading) > self._silence_end_s:
            self._silent_s = 0.0

    def _may_bounce(self, reported_s: float) -> bool:
        """Return whether this is the first report of off in a row, of a bridge that switches on.

        A bridge that had the time to stop unseen does not bounce.
        """
        switches = reported_s - self._commanded_s <= self._grace_s
        if self._bounced_s is None and switches and not (self._gap_s or self._silent_s):
            self._bounced_s = reported_s
        return self._bounced_s == reported_s

    def _is_overdue(self, reported_s: float) -> bool:
        """Return whether a bridge that has not come on yet has had the time to."""
        if self._due_s == math.inf:
            return False
        if self._off_s is None:
            self._off_s = max(reported_s, self._due_s) - self._reading_s
        return reported_s - self._off_s > self._grace_s + _SLACK_S

    @property
    def _hidden(self) -> str:
        """The time that has hidden the stop, or in which a drive has not come on: for the trip."""
        if not self._been_on:
            return f"; it has not come on within {self._grace_s * 1e3:.0f} ms"
        if self._gap_s > self._on_s:
            return f"; the daemon had not run for {self._gap_s * 1e3:.0f} ms"
        if self._silent_s:
            return f"; nothing had been heard of it for {self._silent_s * 1e3:.0f} ms"
        return ""

    def _note_silence(self, reading: Reading, now_s: float) -> None:
        """Keep the longest time without a reading, or without a report of the bridge.

        A reading ends it whose values were asked for before: a poll may take as long.
        """
        silent_s, limit_s = now_s - _bridge_report_s(reading), self._mute_limit_s
        if silent_s <= limit_s:
            silent_s, limit_s = now_s - reading.arrival_s, self._silent_limit_s
        if silent_s > limit_s:
            self._silent_s, self._silence_end_s = max(self._silent_s, silent_s), now_s


def _bridge_report_s(reading: Reading) -> float:
    """Return when the report of the bridge came: with the reading if it has no separate time."""
    return reading.arrival_s if reading.bridge_s is None else reading.bridge_s


# A loss, a silence or a new start, of which the next report shows whether the drive has stopped.

_STOPPED = "drive stopped: its bridge is off although it was commanded on"

LOST = "the bus was lost meanwhile"
LEAPT = "its alive counter leapt meanwhile: it may have started anew"
UNANSWERED = "a read had no answer meanwhile"
UNREAD = "no poll gave a reading meanwhile"


class Relink:
    """A drive that was on when its bus was lost or fell silent, until the next reading.

    The drive may have stopped by its own time-out meanwhile, or have started anew. A command that
    has the bridge on waits for the reading. If that has the bridge off and the last one before the
    loss had it on, the drive is not driven on; one that was about to start may continue.
    """

    def __init__(self) -> None:
        """Begin without a connection, and without a command."""
        self._commanded = False
        self._was_on = False
        self._reported_on = False
        self._stopped = False
        self._how = LOST

    @property
    def trip_cause(self) -> Trip | None:
        """Reason not to energise the drive, None for none."""
        return Trip(TripKind.DRIVE_STOPPED, f"{_STOPPED}; {self._how}") if self._stopped else None

    def open(self, *, bridge: bool, how: str = LOST, reported_on: bool = False) -> None:
        """Begin a connection, or a silence of one.

        Args:
            bridge: Whether the last command that reached the drive had the bridge on.
            how: Why nothing comes from the drive.
            reported_on: Whether its last report, also one that no reading carries, has it on.
        """
        # the earlier cause is the more specific one
        if not (self._was_on and how in {UNREAD, LEAPT}):
            self._how = how
        self._was_on = self._commanded and (self._was_on or bridge)
        self._reported_on = self._reported_on or reported_on

    def note_reading(self, *, bridge: bool) -> None:
        """Note a reading.

        Args:
            bridge: Whether it has the bridge on.
        """
        self._stopped = self._stopped or (self._was_on and self._reported_on and not bridge)
        self._was_on, self._reported_on = False, bridge

    def note_command(self, *, bridge: bool, safe: bool) -> None:
        """Note a command, sent or not; the safe one ends what was driven.

        Args:
            bridge: Whether it has the bridge on.
            safe: Whether it is the safe command.
        """
        self._commanded = bridge
        if safe:
            self._stopped = self._was_on = False

    def admits(self, *, bridge: bool) -> bool:
        """Return whether a command may be sent.

        Args:
            bridge: Whether it has the bridge on.
        """
        return not (bridge and (self._was_on or self._stopped))


# Other senders of commands.

QUIET_S = 5.0
"""Time without a foreign command until the drive may be energised. A sender commands its drive
many times in it, as every drive has a time-out far shorter than this."""


class OtherSender:
    """Remembers the last command frame on the bus that this process has not sent."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """Start without another sender.

        Args:
            clock: Monotonic clock, in seconds.
        """
        self._clock = clock
        self._frame = ""
        self._count = 0
        self._came_s = -math.inf

    def note(self, frame: str) -> None:
        """Note a foreign command frame.

        Args:
            frame: The frame's id and name, as text.
        """
        now_s = self._clock()
        self._count = 1 if now_s - self._came_s > QUIET_S else self._count + 1
        self._frame, self._came_s = frame, now_s

    @property
    def trip_cause(self) -> Trip | None:
        """Reason not to energise the drive, None without a recent foreign command."""
        age_s = self._clock() - self._came_s
        if age_s > QUIET_S:
            return None
        return Trip(
            TripKind.OTHER_SENDER,
            f"another sender commands this drive: {self._count} x frame {self._frame}, the last "
            f"{age_s:.1f} s ago; end the other daemon, PLC or tool: the bus must be free of its "
            f"commands for {QUIET_S:g} s",
        )
