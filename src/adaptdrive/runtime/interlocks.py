"""Interlocks: what must hold while the drive is energised, and the last look at a command.

Each check gives the cause of a trip in words, or None. A trip is latched by the state machine;
`reset` is refused while a cause is still there.
"""

import math

from adaptdrive.devices.port import Port
from adaptdrive.runtime.settings import FastLoopSettings
from adaptdrive.runtime.stopping import BridgeWatch
from adaptdrive.runtime.timebase import HalfCycles
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.frame_rate import verdict_ticks
from adaptdrive.safety.interlocks import find_cause
from adaptdrive.safety.trips import Trip, TripKind

_PAUSE_READINGS = 3.0
"""Readings without an evaluation after which this process did not run: counts jump by as many."""

_PRIORITY = "give the daemon priority by realtime.priority: docs/proof/realtime.md"


class InterlockBoard:
    """The interlocks of a drive, and the time since they were last evaluated."""

    def __init__(self, settings: FastLoopSettings, port: Port, half_cycles: HalfCycles) -> None:
        """Evaluate nothing yet.

        Args:
            settings: Trip levels, watches over the output and times of the drive.
            port: The drive.
            half_cycles: Its time base: the rate of its frames, unless this process decides it, and
                its half-cycle counter.
        """
        timing = settings.timing
        reported, cycle_s = port.stop_slack_s is not None, port.bridge_cycle_s
        self._port = port
        self._limits = settings.limits
        self._watches = [build() for build in settings.watches]
        self._rate = half_cycles.rate if settings.drive_clocks else None
        self._counts = half_cycles.counts
        self._bridge = BridgeWatch(timing, reported=reported, cycle_s=cycle_s)
        self._watched_s = math.inf
        self._pause_s, self._paused_s = 0.0, -math.inf
        self._least_pause_s = _PAUSE_READINGS * timing.reading_s
        self._judged_over_s = verdict_ticks(timing.ticks_per_reading) * timing.half_cycle_s
        self._stale_s = timing.stale_s
        self._gap_limit_s = timing.overslept_s

    def unknown_rate(self, now_s: float) -> Trip | None:
        """Return why the drive's rate is not known, at which it is not energised; None once it is.

        Args:
            now_s: Monotonic time.
        """
        if self._rate is None or self._rate.judged:
            return None
        if busy := self._busy(now_s):
            return Trip(TripKind.MACHINE_BUSY, busy)
        return Trip(
            TripKind.RATE_UNKNOWN,
            "the drive's half-cycle counter jumps again and again, or its readings are too few: "
            "look for a gateway that repeats or loses frames, and at signals.counter",
        )

    def awaits_bridge(self, now_s: float) -> bool:
        """Return whether nothing that energises may be sent before the drive has reported again."""
        return self._counts.may_have_restarted or self._bridge.must_report(now_s - self._watched_s)

    def look(self, now_s: float) -> None:
        """Note an evaluation, and the longest time of late in which this process did not run."""
        pause_s = now_s - self._watched_s
        if pause_s > self._least_pause_s and (pause_s > self._pause_s or not self._busy(now_s)):
            self._pause_s, self._paused_s = pause_s, now_s
        self._watched_s = now_s

    def standing_cause(self, reading: Reading | None, now_s: float) -> Trip | None:
        """Return the interlock that is active in any state; the drive's protocol comes first."""
        cause = self._port.trip_cause or find_cause(
            reading, now_s, self._limits, self._stale_s, self._port.explain_age
        )
        if cause is not None or self._rate is None:
            return cause
        standing_s, limit_s = self._rate.standing_s, self._stale_s
        if standing_s <= limit_s:
            wrong, busy = self._rate.cause, self._busy(now_s)
            if wrong is not None and busy:
                return Trip(TripKind.MACHINE_BUSY, f"{wrong}; {busy}")
            return wrong
        return Trip(  # the readings may be one reading, repeated
            TripKind.COUNTER_STANDS,
            f"half-cycle counter: the drive's count has stood for {standing_s * 1e3:.0f} ms while "
            f"frames come, limit {limit_s * 1e3:g} ms: its control hangs, or its last frame is "
            "repeated",
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
    ) -> Trip | None:
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

    def gap_cause(self, now_s: float) -> Trip | None:
        """Return the cause of a trip when this process did not run for long until now."""
        unwatched_s = now_s - self._watched_s
        if unwatched_s <= self._gap_limit_s:
            return None
        return Trip(
            TripKind.OVERSLEPT,
            f"overslept: the daemon did not run for {unwatched_s * 1e3:.0f} ms, limit "
            f"{self._gap_limit_s * 1e3:g} ms: the machine is overloaded or was suspended; set "
            f"interlocks.stale_s (now {self._stale_s:g}) to {2.0 * unwatched_s:.2g} where "
            f"the drive's own time-out allows it, or {_PRIORITY}",
        )

    def late_command_cause(self, now_s: float) -> Trip | None:
        """Return the cause of a trip when a drive that may have stopped was just driven on.

        This process did not run between its last look at the drive and the bus, and the next report
        shows the bridge on in either case.
        """
        unwatched_s = now_s - self._watched_s
        if not self._bridge.hides_stop(unwatched_s):
            return None
        return Trip(
            TripKind.OVERSLEPT,
            f"overslept: the daemon did not run for {unwatched_s * 1e3:.0f} ms while "
            "it sent a command: the drive may have stopped by itself and been switched on again; "
            f"{_PRIORITY}",
        )

    def _implausible(self, reading: Reading, *, running: bool) -> Trip | None:
        """Return why the output cannot be that of the load, although its sensor still sends."""
        cause: Trip | None = None
        for watch in self._watches:
            if running:
                cause = cause or watch.find_cause(reading)
            else:
                watch.forget()
        return cause
