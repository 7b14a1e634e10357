"""The fold: facts that the port of a drive reports, and time, to one verdict about the drive.

A port reports each fact once, with its time: what the drive says of its bridge, what it was
commanded, what it may have received and has taken, a lost bus, a counter that leapt, another
sender. The verdict is whether the drive may be driven on. Five rules make it:

1. Off by a drive that has come on by command is a stop. While its contact switches, off may be a
   bounce: what energises waits for the report of the next reading, which decides.
2. A drive that has not come on has its time to do so.
3. A time in which the drive may have stopped unseen is a doubt. What energises waits for a report
   from after it; off after a doubt is a stop, without a bounce.
4. A drive that never reports its bridge shows nothing, and is commanded all the same: a time alone
   is no doubt of it. After any other doubt it is assumed to be as the last command that it has
   received.
5. A drive that is still on long after the safe command, or has not acknowledged it, does not obey.
"""

import math
from collections.abc import Callable
from enum import Enum
from typing import Final

from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip, TripKind

_SLACK_S = 1e-6
"""Rounding of sums of half cycles: the last one within the grace is not yet a stop."""

_NEXT_SHARE = 0.9
"""Share of a reading after which a report is that of the next one: frames come a little early."""

QUIET_S = 5.0
"""Time without a foreign command until the drive may be energised. A sender commands its drive
many times in it, as every drive has a time-out far shorter than this."""


class Verdict(Enum):
    """What the facts say of a drive."""

    OBEYS = "It does what it was commanded, as far as its reports show: commands go out."
    MAY_HAVE_STOPPED = "It may have stopped unseen: what energises waits for its next report."
    STOPPED = "It has stopped, or has not come on in its time: the daemon trips."
    DISOBEYS = "It is still on long after the safe command: nothing feeds its own time-out."


class Doubt(Enum):
    """Why a drive may have stopped unseen, as a trip says it; the first that holds is named."""

    BUS_LOST = "the bus was lost meanwhile"
    LEAPT = "its alive counter leapt meanwhile: it may have started anew"
    STANDS = "its heartbeat stood still meanwhile"
    UNANSWERED = "a read had no answer meanwhile"
    ASLEEP = "the daemon had not run for {:.0f} ms"
    SILENT = "nothing had been heard of it for {:.0f} ms"


FACTS: Final = {
    Doubt.BUS_LOST: "A bus, a link or a node was lost.",
    Doubt.LEAPT: "An alive counter advanced by more than frames may be lost.",
    Doubt.STANDS: "The heartbeat register of a drive that is polled did not advance in its time.",
    Doubt.UNANSWERED: "A drive that is polled answered no read and took no command for `silent_s`.",
    Doubt.ASLEEP: "Two looks of the fast loop were further apart than `asleep_s`.",
    Doubt.SILENT: "No report of the bridge, or no reading, came for `silent_s` or `unreported_s`.",
}
"""What a port, or the look of a tick, has seen."""

_SILENT: Final = Doubt.SILENT


class Monitor:
    """The facts of one drive, and the verdict that follows from them.

    Attributes:
        slack_s: Additional age of the report of the bridge; None for a drive that never reports it.
        cycle_s: Time from one report of the bridge to the next, 0 where each reading has one,
            infinite where it is not known.
        powered: Whether the newest report has the bridge on, also one from before a loss, and one
            that may be old.
        given: Whether the last command that the drive may have received has the bridge on.
        safe_s: When the bus, or the drive where its protocol acknowledges commands, has taken the
            safe command in force; infinite without one.
    """

    def __init__(
        self,
        timing: Timing,
        clock: Callable[[], float],
        *,
        slack_s: float | None = 0.0,
        cycle_s: float = 0.0,
        acknowledges: bool = False,
    ) -> None:
        """Begin without a fact.

        Args:
            timing: Times of the drive.
            clock: Monotonic clock, in s.
            slack_s: As the attribute.
            cycle_s: As the attribute.
            acknowledges: Whether the drive acknowledges each command: the safe one, too, must have
                been, and what a lost bus has carried is known.
        """
        self._acknowledges = acknowledges
        self._clock = clock
        # the limits, which do not change, are computed once
        self._reading_s, self._switched_on_s = timing.reading_s, timing.switched_on_s
        self._asleep_s, self._unseen_s = timing.asleep_s, timing.unseen_s
        self._silent_s, self._unreported_s = timing.silent_s, timing.unreported_s(cycle_s)
        self._hidden_s = timing.hidden_s(cycle_s)
        self._obeyed_s = timing.obeyed_s(max(cycle_s, timing.reading_s))
        self._taken_s = timing.taken_s
        self.slack_s, self.cycle_s = slack_s, cycle_s
        self.powered = self.given = False
        self.safe_s = self._offered_s = math.inf
        self._begun_s = -math.inf
        self._came_s = math.inf
        self._foreign, self._foreign_count, self._foreign_s = "", 0, -math.inf
        self._commanded = self._lingers = False
        self._doubts: dict[Doubt, tuple[float, float]] = {}
        self._been_on = self._come = self._stopped = False
        self._off_s = self._first_off_s = self._bounced_s = math.inf
        self._commanded_s = self._due_s = math.inf

    # Facts.

    def report(self, *, on: bool, asked_s: float, came_s: float) -> None:
        """Note what the drive reports of its bridge.

        Args:
            on: Whether it is on.
            asked_s: When the report was asked for; when it came, of a drive that sends by itself.
            came_s: When it came.
        """
        self.powered, self._came_s = on, came_s
        self._off_s = math.inf if on else asked_s
        if not self._commanded:
            return
        if on:
            self._note_on(asked_s)
            self._first_off_s = self._bounced_s = math.inf
        else:
            self._note_off(asked_s)
        if not self._stopped:
            self._end_doubts(asked_s, came_s)

    def hint(self, *, on: bool, came_s: float) -> None:
        """Note what a frame says of the bridge that may be an old one: it ends no doubt.

        Args:
            on: Whether it is on.
            came_s: When the frame came.
        """
        self.powered = self.powered or on
        if self._commanded and on:
            self._note_on(came_s)
        elif self._commanded:
            self._note_off(came_s)

    def doubt(self, why: Doubt, until_s: float, span_s: float = 0.0) -> None:
        """Note a time in which a drive that is driven may have stopped unseen.

        Args:
            why: The reason.
            until_s: End of that time.
            span_s: Its length, where the reason has one.
        """
        if self._commanded and self._is_driven:
            longest_s = max(span_s, self._doubts.get(why, (0.0, 0.0))[1])
            self._doubts[why] = until_s, longest_s

    def lose(self) -> None:
        """Note that the bus was lost: nothing that was sent on it counts any more."""
        self.doubt(Doubt.BUS_LOST, self._clock())
        self.given, self.safe_s, self._begun_s = False, math.inf, self._clock()
        if not self._acknowledges:
            self._offered_s = math.inf

    def command(self, command: Command) -> None:
        """Note the command that was decided on, whether or not it can be sent.

        Args:
            command: The command.
        """
        if command != SAFE_COMMAND:
            self.safe_s = self._offered_s = math.inf
        if command.bridge and not self._commanded:
            self._lingers = self.powered
        elif self._commanded and not command.bridge:
            self._rest()
        self._commanded = command.bridge

    def offer(self, command: Command) -> None:
        """Note that the drive may receive a command from now on.

        Of the safe command the first time counts; any other one ends it, whenever it was decided.

        Args:
            command: The command.
        """
        self.given = self.given or command.bridge
        if command == SAFE_COMMAND:
            self._offered_s = min(self._offered_s, self._clock())
        else:
            self.safe_s = self._offered_s = math.inf

    def take(self, command: Command) -> None:
        """Note that the bus, or the drive where it acknowledges commands, has taken a command.

        Args:
            command: The command.
        """
        self.offer(command)
        self.given = command.bridge
        if command == SAFE_COMMAND:
            self.safe_s = min(self.safe_s, self._clock())

    def note_foreign(self, frame: str) -> None:
        """Note a command to the drive that this process has not sent.

        Args:
            frame: The id and the name of its frame, as text.
        """
        now_s = self._clock()
        self._foreign_count = 1 if now_s - self._foreign_s > QUIET_S else self._foreign_count + 1
        self._foreign, self._foreign_s = frame, now_s

    # Verdict.

    @property
    def verdict(self) -> Verdict:
        """What the facts say now, for the next command to the bus."""
        if not self._commanded:
            return Verdict.DISOBEYS if self.overdue_s > 0.0 else Verdict.OBEYS
        if self._stopped:
            return Verdict.STOPPED
        if self._awaits_report or self._is_silent(self._clock()):
            return Verdict.MAY_HAVE_STOPPED
        return Verdict.OBEYS

    @property
    def stop(self) -> Trip | None:
        """Why a drive that was commanded on has stopped, until it is commanded off, else None."""
        if not self._stopped:
            return None
        why = next((one for one in Doubt if one in self._doubts), None)
        if why is not None:
            hidden = f"; {why.value.format(self._doubts[why][1] * 1e3)}"
        else:
            waited_ms = self._switched_on_s * 1e3
            hidden = "" if self._been_on else f"; it has not come on within {waited_ms:.0f} ms"
        text = f"drive stopped: its bridge is off although it was commanded on{hidden}"
        return Trip(TripKind.DRIVE_STOPPED, text)

    @property
    def overdue_s(self) -> float:
        """Time for which the drive has not obeyed the safe command; negative while it may yet."""
        now_s, offered_s = self._clock(), self._offered_s
        still_on_s = now_s - offered_s - self._obeyed_s if self.powered else -math.inf
        if not self._acknowledges or self.safe_s < math.inf:
            return still_on_s
        # without a link nothing can acknowledge it
        return max(still_on_s, now_s - max(offered_s, self._begun_s) - self._taken_s)

    @property
    def trip_cause(self) -> Trip | None:
        """Reason not to energise the drive in any state: a recent command of another sender."""
        age_s = self._clock() - self._foreign_s
        if age_s > QUIET_S:
            return None
        return Trip(
            TripKind.OTHER_SENDER,
            f"another sender commands this drive: {self._foreign_count} x frame {self._foreign}, "
            f"the last {age_s:.1f} s ago; end the other daemon, PLC or tool: the bus must be free "
            f"of its commands for {QUIET_S:g} s",
        )

    def look(self, now_s: float, unwatched_s: float, heard_s: float, *, due: bool) -> Trip | None:
        """Note the time that has passed; return the cause of a trip, None for none.

        Args:
            now_s: Monotonic time.
            unwatched_s: Time since the last look.
            heard_s: When the newest reading came.
            due: Whether a bridge that has not been on yet must come on; not while a drive starts.
        """
        if not self._commanded:
            return None
        if self.slack_s is not None:
            self._note_passed(now_s, unwatched_s, heard_s)
        self._commanded_s = min(self._commanded_s, now_s)
        self._due_s = min(self._due_s, now_s) if due else math.inf
        # off that was reported in a time without a look, or after a silence, was no bounce
        unseen = self._bounced_s < math.inf and bool(self._doubts)
        overdue = not self._come and self._is_overdue()
        self._stopped = self._stopped or unseen or overdue
        return self.stop

    def must_report(self, unwatched_s: float) -> bool:
        """Return whether what energises waits for a report, after a time without a look.

        Args:
            unwatched_s: Time since the last look.
        """
        unseen = self._been_on and unwatched_s > self._unseen_s and self.slack_s is not None
        return self._awaits_report or unseen

    def hides_stop(self, unwatched_s: float) -> bool:
        """Return whether a command that was late on the bus may have hidden a stop.

        Args:
            unwatched_s: Time from the last look until after that command.
        """
        return self.must_report(unwatched_s) and unwatched_s > self._hidden_s

    # The fold.

    def _rest(self) -> None:
        """Begin anew with a drive that is commanded off; its bridge may still be on."""
        self._doubts.clear()
        self._been_on = self._come = self._stopped = False
        self._first_off_s = self._bounced_s = math.inf
        self._commanded_s = self._due_s = math.inf

    @property
    def _awaits_report(self) -> bool:
        return bool(self._doubts) or self._bounced_s < math.inf

    def _is_silent(self, now_s: float) -> bool:
        """Return whether the bridge was not reported for as long as a stop takes."""
        driven = self._is_driven and self.slack_s is not None
        return driven and now_s - self._came_s > self._unreported_s

    @property
    def _is_driven(self) -> bool:
        """True if a command may have it on, or has had: what was sent since does not matter."""
        return self.given or self._been_on

    def _note_passed(self, now_s: float, unwatched_s: float, heard_s: float) -> None:
        """Note a time in which nobody looked, or in which nothing came."""
        if unwatched_s > self._asleep_s:
            self.doubt(Doubt.ASLEEP, now_s, unwatched_s)
        if self._is_silent(now_s):
            self.doubt(_SILENT, now_s, now_s - self._came_s)
        elif now_s - heard_s > self._silent_s:
            self.doubt(_SILENT, now_s, now_s - heard_s)

    def _note_on(self, asked_s: float) -> None:
        """Note a bridge that is on, by this command unless it still is by the one before."""
        switched = asked_s - self._commanded_s > self._switched_on_s
        self._come = self._come or switched or not self._lingers
        self._been_on = True

    def _note_off(self, asked_s: float) -> None:
        """Note a bridge that is off: of one that has been on it is a stop, or a bounce."""
        self._lingers = False
        switches = asked_s - self._commanded_s <= self._switched_on_s
        again = asked_s - self._bounced_s > _NEXT_SHARE * self._reading_s
        if self._come and switches and not (again or self._doubts):
            self._bounced_s = min(self._bounced_s, asked_s)
        elif self._come or (self._been_on and self._doubts):
            self._stopped = True

    def _end_doubts(self, asked_s: float, came_s: float) -> None:
        """End the doubts from before a report; it ends a silence although it was asked for then."""
        if self._doubts:
            self._doubts = {
                why: (until_s, span_s)
                for why, (until_s, span_s) in self._doubts.items()
                if (came_s if why is _SILENT else asked_s) <= until_s
            }

    def _is_overdue(self) -> bool:
        """Return whether a bridge that has not come on yet has had the time to."""
        if math.inf in {self._due_s, self._off_s}:
            return False
        begin_s = max(self._off_s, self._due_s) - self._reading_s
        self._first_off_s = min(self._first_off_s, begin_s)
        return self._off_s - self._first_off_s > self._switched_on_s + _SLACK_S
