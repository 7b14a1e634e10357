"""All interlocks of one drive at a tick, a stop by itself among them: the first cause counts."""

import math

from adaptdrive.config.timing import Timing
from adaptdrive.devices.port import Port, Reading
from adaptdrive.runtime import frame_rate, timebase
from adaptdrive.runtime.interlocks import find_cause
from adaptdrive.runtime.settings import FastLoopSettings

# Notices a drive that has stopped by itself: it must not be driven on as if it had not.

_SLACK_S = 1e-6
"""Rounding of sums of half cycles: the last one within the grace is not yet a stop."""


class BridgeWatch:
    """Finds a drive that reports its bridge off although it was commanded on."""

    def __init__(
        self, timing: Timing, *, reported: bool = True, cycle_s: float = 0.0, queued: bool = True
    ) -> None:
        """Watch from the first half cycle.

        Args:
            timing: Times of the drive.
            reported: Whether the drive reports its bridge: after a silence nothing else shows that
                it has not stopped.
            cycle_s: Time from one such report to the next, 0 where each reading has one, infinite
                where it is not known.
            queued: Whether reports come and wait while this process does not run.
        """
        self._reading_s = timing.reading_s
        self._grace_s = timing.switched_on_s
        self._on_s = timing.unseen_s
        self._hidden_s, self._queued = timing.hidden_s, queued
        self._lag_s = 0.0
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
    ) -> str | None:
        """Return the cause of a trip, None for none.

        Only reports of the drive count: one that has fallen silent is stale, not off. A bridge that
        has come on by command and is off is a stop at once; one that has not been on yet has its
        time to switch. In that time one report of off after one of on may be a contact that
        bounces: the next report decides. A report from before the command says nothing of what
        follows it.

        A drive may have stopped while this process did not run, or while nothing was heard of its
        bridge, whatever else came: a report from before the end of that time says nothing of it.

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
        self._lag_s = max(self._lag_s, reading.arrival_s - _heard_s(reading))
        self._due_s = min(self._due_s, now_s) if commanded and due else math.inf
        if not commanded:
            self._rest(bridge=reading.bridge)
            return None
        self._commanded_s = min(self._commanded_s, now_s)
        if reading.bridge:
            self._see_on(reading)
            return None
        self._lingers = False
        if self._been_on and self._may_bounce(reading.bridge_reported_s):
            return None
        if not self._been_on and not self._is_overdue(reading.bridge_reported_s):
            return None
        return f"drive stopped: its bridge is off although it was commanded on{self._hidden}"

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
        limit_s = self._hidden_s(self._lag_s if self._queued else math.inf)
        return unwatched_s > limit_s and self.must_report(unwatched_s)

    def _rest(self, *, bridge: bool) -> None:
        """Begin anew with a drive that is commanded off; its bridge may still be on."""
        self._off_s, self._been_on, self._lingers = None, False, bridge
        self._bounced_s = None
        self._commanded_s = math.inf
        self._gap_s = self._silent_s = self._lag_s = 0.0

    def _see_on(self, reading: Reading) -> None:
        """Note a bridge that is on, by this command unless it still is by the one before."""
        self._off_s = self._bounced_s = None
        reported_s = reading.bridge_reported_s
        switched = not self._lingers or reported_s - self._commanded_s > self._grace_s
        self._been_on = self._been_on or switched
        if reported_s > self._gap_end_s:
            self._gap_s = 0.0
        if _heard_s(reading) > self._silence_end_s:
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
        silent_s, limit_s = now_s - _heard_s(reading), self._mute_limit_s
        if silent_s <= limit_s:
            silent_s, limit_s = now_s - reading.arrival_s, self._silent_limit_s
        if silent_s > limit_s:
            self._silent_s, self._silence_end_s = max(self._silent_s, silent_s), now_s


def _heard_s(reading: Reading) -> float:
    """Return when the report of the bridge came: with the reading if it has no separate time."""
    return reading.arrival_s if reading.bridge_s is None else reading.bridge_s


# All interlocks of one drive at a tick: the first cause counts.

_PAUSE_READINGS = 3.0
"""Readings without an evaluation after which this process did not run: counts jump by as many."""

_PRIORITY = "give the daemon priority by realtime.priority: docs/proof/realtime.md"


class InterlockBoard:
    """The interlocks of a drive, and the time since they were last evaluated."""

    def __init__(
        self, settings: FastLoopSettings, port: Port, half_cycles: timebase.HalfCycles
    ) -> None:
        """Evaluate nothing yet.

        Args:
            settings: Trip levels, watches over the output and times of the drive.
            port: The drive.
            half_cycles: Its time base: the rate of its frames, unless this process decides it, and
                its half-cycle counter.
        """
        timing, queued = settings.timing, settings.drive_clocks
        reported, cycle_s = port.stop_slack_s is not None, port.bridge_cycle_s
        self._port = port
        self._limits = settings.limits
        self._watches = [build() for build in settings.watches]
        self._rate = half_cycles.rate if queued else None
        self._counts = half_cycles.counts
        self._bridge = BridgeWatch(timing, reported=reported, cycle_s=cycle_s, queued=queued)
        self._watched_s = math.inf
        self._pause_s, self._paused_s = 0.0, -math.inf
        self._least_pause_s = _PAUSE_READINGS * timing.reading_s
        self._judged_over_s = (
            frame_rate.verdict_ticks(timing.ticks_per_reading) * timing.half_cycle_s
        )
        self._stale_s = timing.stale_s
        self._gap_limit_s = timing.overslept_s

    def rate_doubt(self, now_s: float) -> str | None:
        """Return why the drive's rate is not known, at which it is not energised; None once it is.

        Args:
            now_s: Monotonic time.
        """
        if self._rate is None or self._rate.judged:
            return None
        return self._busy(now_s) or (
            "the drive's half-cycle counter jumps again and again, or its readings are too few: "
            "look for a gateway that repeats or loses frames, and at signals.counter"
        )

    def awaits_bridge(self, now_s: float) -> bool:
        """Return whether nothing that energises may be sent before the drive has reported again."""
        return self._counts.in_doubt or self._bridge.must_report(now_s - self._watched_s)

    def look(self, now_s: float) -> None:
        """Note an evaluation, and the longest time of late in which this process did not run."""
        pause_s = now_s - self._watched_s
        if pause_s > self._least_pause_s and (pause_s > self._pause_s or not self._busy(now_s)):
            self._pause_s, self._paused_s = pause_s, now_s
        self._watched_s = now_s

    def standing_cause(self, reading: Reading | None, now_s: float) -> str | None:
        """Return the interlock that is active in any state; the drive's protocol comes first."""
        cause = self._port.complaint or find_cause(
            reading, now_s, self._limits, self._stale_s, self._port.explain_age
        )
        if cause is not None or self._rate is None:
            return cause
        standing_s, limit_s = self._rate.standing_s, self._stale_s
        if standing_s <= limit_s:
            wrong, busy = self._rate.cause, self._busy(now_s)
            return f"{wrong}; {busy}" if wrong and busy else wrong
        return (  # the readings may be one reading, repeated
            f"half-cycle counter: the drive's count has stood for {standing_s * 1e3:.0f} ms while "
            f"frames come, limit {limit_s * 1e3:g} ms: its control hangs, or its last frame is "
            "repeated"
        )

    def _busy(self, now_s: float) -> str:
        """Return that this process did not run while the rate was judged, empty where it did."""
        if now_s - self._paused_s > self._judged_over_s:
            return ""
        return (
            f"this machine was busy: the daemon did not run for {self._pause_s * 1e3:.0f} ms, and "
            f"readings come late or are lost meanwhile; {_PRIORITY}"
        )

    def running_cause(
        self, reading: Reading | None, now_s: float, *, running: bool, bridge: bool
    ) -> str | None:
        """Evaluate every interlock of an energised drive.

        Args:
            reading: The newest reading, None before the first.
            now_s: Monotonic time.
            running: Whether the drive runs; while it starts, its bridge may be reported late.
            bridge: Whether the last command had the bridge on.
        """
        unwatched_s, gap_cause = now_s - self._watched_s, self.gap_cause(now_s)
        self.look(now_s)
        cause = gap_cause or self.standing_cause(reading, now_s)
        if cause is not None or reading is None:  # without a reading there is always a cause
            return cause
        cause = self._bridge.find_cause(
            reading, commanded=bridge, due=running, unwatched_s=unwatched_s, now_s=now_s
        ) or self._counts.find_cause(commanded=bridge)
        return cause or self._implausible(reading, running=running)

    def gap_cause(self, now_s: float) -> str | None:
        """Return the cause of a trip when this process did not run for long until now."""
        unwatched_s = now_s - self._watched_s
        if unwatched_s <= self._gap_limit_s:
            return None
        return (
            f"overslept: the daemon did not run for {unwatched_s * 1e3:.0f} ms, limit "
            f"{self._gap_limit_s * 1e3:g} ms: the machine is overloaded or was suspended; set "
            f"interlocks.stale_s (now {self._stale_s:g}) to {2.0 * unwatched_s:.2g} where "
            f"the drive's own time-out allows it, or {_PRIORITY}"
        )

    def blind_cause(self, now_s: float) -> str | None:
        """Return the cause of a trip when a drive that may have stopped was just driven on.

        This process did not run between its last look at the drive and the bus, and the next report
        says that the bridge is on in either case.
        """
        unwatched_s = now_s - self._watched_s
        if not self._bridge.hides_stop(unwatched_s):
            return None
        return (
            f"overslept: the daemon did not run for {unwatched_s * 1e3:.0f} ms while "
            "it sent a command: the drive may have stopped by itself and been switched on again; "
            f"{_PRIORITY}"
        )

    def _implausible(self, reading: Reading, *, running: bool) -> str | None:
        """Return why the output cannot be that of the load, although its sensor still sends."""
        cause: str | None = None
        for watch in self._watches:
            if running:
                cause = cause or watch.find_cause(reading)
            else:
                watch.forget()
        return cause
