"""Interlocks: limits of one reading, and all that must hold while a drive is energised.

Each check gives the trip, or None. A trip is latched by the state machine; `reset` is refused while
a cause is still there.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from adaptdrive.safety.facts import Reading, fault_trip
from adaptdrive.safety.frames import CounterWatch, FrameRate, verdict_ticks
from adaptdrive.safety.monitor import Monitor
from adaptdrive.safety.plausibility import Watch
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.quantity import BOOST, MEASURED, Display, Given


@dataclass(frozen=True, slots=True)
class Limits:
    """Trip levels.

    Attributes:
        boost_voltage_max_V: Over-voltage.
        output_max: Highest output.
        display: Unit of the output for people, for the text of the trip.
        output_name: Name of the output, as above.
        output_min: Lowest output.
        absent: Quantities that nobody measures.
        given: Name and unit of what the drive gives, for the text of the trip.
    """

    boost_voltage_max_V: float
    output_max: float
    display: Display
    output_name: str = "output"
    output_min: float = -math.inf
    absent: frozenset[str] = frozenset()
    given: Given = BOOST


def find_cause(
    reading: Reading | None,
    now_s: float,
    limits: Limits,
    stale_s: float,
    explain_age: Callable[[], Trip | None] = lambda: None,
) -> Trip | None:
    """The first reason why the drive must not be energised, None when there is none.

    Args:
        reading: The latest reading, None before the first.
        now_s: Monotonic time.
        limits: Trip levels.
        stale_s: Oldest usable measurement.
        explain_age: Returns the oldest value and why it is old, with the kind of a trip for it;
            called for a stale reading alone.
    """
    if reading is None:
        return _stale(TripKind.NO_MEASUREMENT, "no measurement yet", explain_age())
    age_s = now_s - reading.oldest_s
    limit_s = stale_s + reading.slack_s
    if not age_s <= limit_s:
        text = f"measurement is {age_s * 1e3:.0f} ms old, limit {limit_s * 1e3:g} ms"
        return _stale(TripKind.STALE, text, explain_age())
    return _unhealthy(reading, limits.absent) or _exceeded(reading, limits)


def _stale(kind: TripKind, text: str, why: Trip | None) -> Trip:
    """Return the trip of an old measurement, by the likeliest cause where that is known."""
    if why is None:
        return Trip(kind, f"stale: {text}")
    return Trip(why.kind, f"stale: {text}; {why.text}")


def _unhealthy(reading: Reading, absent: frozenset[str]) -> Trip | None:
    name = _not_finite(reading, absent)
    if name is not None:
        return Trip(
            TripKind.NOT_FINITE,
            f"invalid: {name} = {getattr(reading, name)} is not a finite number: look at its "
            "sensor, its scale and offset, and at [derived]",
        )
    if reading.fault:
        return fault_trip(reading.fault, reading.fault_name)
    return None


def _exceeded(reading: Reading, limits: Limits) -> Trip | None:
    if abs(reading.boost_voltage_V) > limits.boost_voltage_max_V:
        given, name = limits.given, "drive above its limit"
        kind = TripKind.ABOVE_LIMIT
        if given.is_boost_voltage:
            kind, name = TripKind.OVER_VOLTAGE, "over-voltage"
        value = given.text(reading.boost_voltage_V, ".1f")
        highest = given.text(limits.boost_voltage_max_V, "g")
        return Trip(kind, f"{name}: {given.name} = {value}, limit {highest}")
    if reading.output > limits.output_max:
        values = _compared(reading.output, limits.output_max, limits)
        text = f"output above its limit: {values}: look for a lost load, or at the sensor"
        return Trip(TripKind.OUTPUT_HIGH, text)
    if reading.output < limits.output_min:
        values = _compared(reading.output, limits.output_min, limits)
        text = f"output below its limit: {values}: is the sensor reversed, or its wire broken?"
        return Trip(TripKind.OUTPUT_LOW, text)
    return None


def _compared(output: float, limit: float, limits: Limits) -> str:
    value, highest = limits.display.text(output, ".4g"), limits.display.text(limit)
    return f"{limits.output_name} = {value}, limit {highest}"


def _not_finite(reading: Reading, absent: frozenset[str]) -> str | None:
    """The name of the first measured quantity that is not a finite number."""
    if (
        math.isfinite(reading.boost_voltage_V)
        and math.isfinite(reading.line_voltage_V)
        and math.isfinite(reading.load_power_W)
        and math.isfinite(reading.output)
    ):
        return None
    odd = (name for name in MEASURED if not math.isfinite(getattr(reading, name)))
    return next((name for name in odd if name not in absent), None)


# All interlocks of one drive at a tick: the first cause counts.


class Source(Protocol):
    """What the interlocks ask of the port of a drive.

    Attributes:
        monitor: Facts that the port has reported, and the verdict on the drive.
    """

    monitor: Monitor

    @property
    def trip_cause(self) -> Trip | None:
        """Reason of the protocol not to energise the drive, None for no reason."""

    def explain_age(self) -> Trip | None:
        """Return the oldest value, and the likeliest cause of its age with its kind."""


_PAUSE_READINGS = 3.0
"""Readings without an evaluation after which this process did not run: counts jump by as many."""

_PRIORITY = "give the daemon priority by realtime.priority: docs/proof/realtime.md"


class InterlockBoard:
    """The interlocks of a drive, and the time since they were last evaluated."""

    def __init__(  # noqa: PLR0913, PLR0917 - all that is judged
        self,
        limits: Limits,
        timing: Timing,
        watches: Iterable[Watch],
        port: Source,
        counts: CounterWatch,
        rate: FrameRate | None,
    ) -> None:
        """Evaluate nothing yet.

        Args:
            limits: Trip levels.
            timing: Times of the drive.
            watches: Watches over the output, in the order of their causes.
            port: The drive.
            counts: Judge of its half-cycle counter.
            rate: Rate of its frames, None where this process decides it.
        """
        self._port = port
        self._limits = limits
        self._watches = tuple(watches)
        self._rate = rate
        self._counts = counts
        self._monitor = port.monitor
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
        return self._counts.may_have_restarted or self._monitor.must_report(now_s - self._watched_s)

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
        cause = self._monitor.look(
            now_s, unwatched_s, reading.arrival_s, due=running
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
        if not self._monitor.hides_stop(unwatched_s):
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
