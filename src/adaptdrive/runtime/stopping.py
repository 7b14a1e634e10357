"""A drive that stops by itself, and one that is commanded to: what its bridge shows of both."""

import math
from collections.abc import Callable
from enum import Enum, auto
from typing import Final

from adaptdrive.control.signals import Stage
from adaptdrive.devices.port import Port
from adaptdrive.runtime.reports import State, StopWord
from adaptdrive.runtime.state_machine import Machine
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


# Holds a drive to its stop: it must confirm that its bridge is off, and keep it off.

_STAYS: Final = "the drive does not stop"

_ON_READINGS = 2
"""Readings with the bridge on that are no flicker of a drive that has just stopped."""


class Stop(Enum):
    """State of the stop of a drive that is commanded off."""

    AWAITED = auto()
    CONFIRMED = auto()
    OVERDUE = auto()
    DENIED = auto()
    """The bridge came on, or was found on, without a command of this daemon."""


class StopWatch:
    """Compares the bridge that an idle drive reports with the safe command in force."""

    def __init__(self, timing: Timing, slack_s: float | None) -> None:
        """Expect a confirmation from the start on.

        Args:
            timing: Times of the drive.
            slack_s: Additional delay of the report of the bridge, None for a drive that never
                reports it.
        """
        self._confirmable = slack_s is not None
        self._coming_s = timing.coming_s
        self.limit_s = timing.switched_off_s + (slack_s or 0.0)
        self._commanded_s = math.inf
        self._confirmed = False
        self._coming = self._been_on = False
        self._come_s = -math.inf
        self._on: list[float] = []

    def release(self, reading: Reading | None = None, *, bridge: bool = False) -> None:
        """Note that the drive is energised: the next stop begins anew.

        Args:
            reading: The latest reading, None before the first.
            bridge: Whether the last command had the bridge on.
        """
        self._been_on = bridge and (self._been_on or (reading is not None and reading.bridge))
        self._coming = bridge and not self._been_on
        self._commanded_s, self._confirmed = math.inf, False

    def command(self, now_s: float) -> None:
        """Note that the drive is commanded off; the first time since its release counts."""
        if self._commanded_s == math.inf:
            self._commanded_s = now_s
            if self._coming:
                self._come_s = now_s + self._coming_s

    def judge(self, reading: Reading | None, safe_s: float, now_s: float) -> Stop:
        """Return what is known now.

        Args:
            reading: The latest reading, None before the first.
            safe_s: When bus or drive took the safe command, infinite while neither has.
            now_s: Monotonic time.
        """
        if not self._confirmable:
            self._confirmed = self._confirmed or safe_s < math.inf
        elif reading is not None and reading.bridge and self._confirmed:
            return self._denied(reading, now_s)
        elif reading is not None and not reading.bridge:
            self._on.clear()
            self._been_on = False
            due_s = max(safe_s, self._commanded_s, self._come_s)
            self._confirmed = self._confirmed or reading.bridge_reported_s > due_s
        if self._confirmed:
            return Stop.CONFIRMED
        return Stop.OVERDUE if now_s - self._commanded_s > self.limit_s else Stop.AWAITED

    def _denied(self, reading: Reading, now_s: float) -> Stop:
        """The bridge is on after a confirmed stop: denied by the second such reading.

        One that no other follows in the time of a stop is the drive's last report.
        """
        if reading.arrival_s not in self._on:
            self._on.append(reading.arrival_s)
        if len(self._on) < _ON_READINGS and now_s - reading.arrival_s <= self.limit_s:
            return Stop.CONFIRMED
        self.await_again(reading.arrival_s)
        return Stop.DENIED

    def await_again(self, now_s: float) -> None:
        """Wait for a confirmation again."""
        self._confirmed, self._commanded_s = False, now_s

    def unconfirmed(self, reading: Reading | None, safe_s: float, now_s: float) -> Trip:
        """Return why the stop is not confirmed, and the likeliest remedy."""
        waited = f"{(now_s - self._commanded_s) * 1e3:.0f} ms after the stop"
        if safe_s == math.inf:
            return Trip(
                TripKind.STOP_NOT_TAKEN,
                f"{_STAYS}: it has not taken the safe command {waited}; check that it accepts "
                "commands from the bus (remote mode, write access), and disconnect its supply",
            )
        if reading is not None and reading.bridge and reading.bridge_reported_s > self._commanded_s:
            return Trip(
                TripKind.NOT_STOPPED,
                f"{_STAYS}: its bridge is still on {waited}; check that it accepts commands from "
                "the bus (remote mode, checksum, another sender), and disconnect its supply",
            )
        return Trip(
            TripKind.STOP_NOT_REPORTED,
            f"{_STAYS}: it has not reported its bridge off {waited}; check its cable and its "
            "supply, and disconnect the supply before the load is touched",
        )


# Stop of a drive: what its reports mean for the state machine.

_SWITCHED_ON: Final = Trip(
    TripKind.SWITCHED_ON,
    "the drive's bridge is on although this daemon did not command it: look for another sender, a "
    "key on its panel, or a drive that restarts by itself",
)


class Stopping:
    """Holds the state machine to what the drive reports of its stop.

    Attributes:
        watch: Compares the reports of the drive with the stop.
        status: Confirmation of the stop by the drive.
    """

    def __init__(
        self, port: Port, timing: Timing, machine: Machine, report: Callable[[Trip], None]
    ) -> None:
        """Await a confirmation from the start on.

        Args:
            port: The drive.
            timing: Its times.
            machine: The state machine.
            report: Takes the problem when a tripped drive does not confirm its stop.
        """
        self._port = port
        self._machine = machine
        self.watch = StopWatch(timing, port.stop_slack_s)
        self._report = report
        self._settled_s = -math.inf
        self._starting = False
        self.status = StopWord.AWAITED

    def start(self) -> None:
        """Note that the boost voltage rises: a stop that ends it begins anew."""
        self._starting = True

    def release(self, reading: Reading | None = None, *, bridge: bool = False) -> None:
        """Note that the drive is energised: its report of the stop before counts no more.

        Args:
            reading: The latest reading, None before the first.
            bridge: Whether the last command had the bridge on.
        """
        self.watch.release(reading, bridge=bridge)
        self._starting = False
        self._settled_s = -math.inf
        self.status = StopWord.AWAITED

    def judge(self, reading: Reading | None, now_s: float) -> None:
        """Compare what the drive reports of its bridge with the stop that it was commanded.

        While only its boost voltage rises, its bridge is commanded off as it was before.
        """
        watch, machine = self.watch, self._machine
        if self._starting and machine.stage is not Stage.PRECHARGE:
            self.release()
        safe_s = -math.inf if self._starting else self._port.safe_s
        watch.command(now_s)
        verdict = watch.judge(reading, safe_s, now_s)
        settled = self._is_settled(verdict, now_s)
        if verdict is Stop.CONFIRMED:
            machine.confirm_stop()
            self.status = self._confirmation(reading, now_s) if settled else self.status
        elif verdict is Stop.DENIED:
            machine.withdraw_stop()
            self._trip(_SWITCHED_ON)
        elif machine.state is State.STANDBY:
            self._await_first_stop(reading, now_s)
        elif machine.state is State.STARTING and (reading is None or not reading.bridge):
            return  # as in `standby`, only a bridge that is on makes a missing report a problem
        elif verdict is Stop.OVERDUE and self.status is not StopWord.MISSING:
            self._trip(watch.unconfirmed(reading, safe_s, now_s))
        elif verdict is Stop.AWAITED and settled:
            self.status = StopWord.AWAITED

    def _confirmation(self, reading: Reading | None, now_s: float) -> StopWord:
        """Return the confirmation of a stop that is complete.

        A drive that has been silent for a stop's time may have been switched on meanwhile: what it
        has confirmed is no report of it now.
        """
        if self._port.stop_slack_s is None:
            return StopWord.IMPOSSIBLE
        if reading is None or now_s - reading.bridge_reported_s > self.watch.limit_s:
            return StopWord.AWAITED
        return StopWord.CONFIRMED

    def _is_settled(self, verdict: Stop, now_s: float) -> bool:
        """Return whether a tripped drive that denied its stop has stayed off for a stop's time.

        Until then its stop is missing: a bridge that chatters makes one alarm, not one each time.
        """
        confirmed, settled = verdict is Stop.CONFIRMED, now_s >= self._settled_s
        if verdict is Stop.DENIED or not (confirmed or settled):
            self._settled_s = now_s + self.watch.limit_s
        return settled or self._machine.state is not State.TRIPPED

    def _await_first_stop(self, reading: Reading | None, now_s: float) -> None:
        """Expect a drive to stop that is found on at the start."""
        if reading is not None and reading.bridge:
            self.watch.await_again(now_s)
            self._machine.withdraw_stop()

    def _trip(self, problem: Trip) -> None:
        """Trip; a drive that had tripped before keeps that cause, and this one is reported once."""
        if self._machine.state is State.TRIPPED and self.status is not StopWord.MISSING:
            self._report(problem)
        self.status = StopWord.MISSING
        self._machine.latch(problem)
