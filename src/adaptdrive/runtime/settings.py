"""Settings of the runtime of one drive: limits and values of requests, the loop's interface."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, Self

from adaptdrive.config.load import LoadSection
from adaptdrive.config.root import DriveSection
from adaptdrive.control.signals import (
    UNKNOWN,
    Decision,
    MovingReference,
    Ramp,
    Reach,
    Snapshot,
    Waveform,
)
from adaptdrive.runtime import reports
from adaptdrive.safety import plausibility
from adaptdrive.safety.interlocks import Limits
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.errors import RefusedError
from adaptdrive.util.quantity import Display

# V_c as the operator sets it in mode `manual`: a ramp to the value asked for, and its expiry.


@dataclass(frozen=True, slots=True)
class ManualVoltage:
    """V_c on its way to the operator's value.

    Attributes:
        start_V: V_c when the value was asked for.
        target_V: The value asked for.
        since_tick: Tick at which it was asked for.
        slew_V: Largest change of V_c in one tick.
        hold_s: Longest time until the next value, None without a limit.
        hold_ticks: The same in ticks.
    """

    start_V: float
    target_V: float
    since_tick: int
    slew_V: float
    hold_s: float | None = None
    hold_ticks: int = 0

    def value(self, tick: int) -> float:
        """Return V_c at a tick, in volts."""
        way_V = self.slew_V * max(0, tick - self.since_tick)
        distance_V = self.target_V - self.start_V
        if abs(distance_V) <= way_V:
            return self.target_V
        return self.start_V + (way_V if distance_V > 0.0 else -way_V)

    def find_cause(self, tick: int) -> Trip | None:
        """Return why the operator must be taken for lost at a tick, None while there is no reason.

        Args:
            tick: Present tick.
        """
        if self.hold_s is None or tick - self.since_tick <= self.hold_ticks:
            return None
        text = f"manual: no new voltage within the {self.hold_s:g} s that its sender had set"
        return Trip(TripKind.OPERATOR_LOST, text)


# The set-point as it was asked for.


@dataclass(frozen=True, slots=True)
class AskedReference:
    """A set-point, and how the reference goes there.

    Attributes:
        setpoint: Constant set-point, or the end of a ramp; the last one while a waveform runs.
        moving: Running waveform or ramp, None while the reference is constant.
        previews: Whether the controller may know what comes.
    """

    setpoint: float
    moving: MovingReference | None = None
    previews: bool = True

    @property
    def waveform(self) -> Waveform | None:
        """The running waveform, None while there is none."""
        form = None if self.moving is None else self.moving.form
        return form if isinstance(form, Waveform) else None

    @property
    def ramp(self) -> Ramp | None:
        """The way to the set-point, None where there is none."""
        form = None if self.moving is None else self.moving.form
        return form if isinstance(form, Ramp) else None

    def value(self, tick: int, tick_s: float) -> float:
        """Return the reference at a tick.

        Args:
            tick: The tick.
            tick_s: Nominal time from tick to tick.
        """
        return self.setpoint if self.moving is None else self.moving.value(tick, tick_s)

    def is_within(self, reach: Reach) -> bool:
        """Return whether V_c can hold every set-point that is asked for."""
        wave = self.waveform
        if wave is None:
            return can_hold(reach, self.setpoint)
        return can_hold(reach, wave.low) and can_hold(reach, wave.high)

    def begun(self, tick: int) -> Self:
        """Return the same with a ramp that begins at a tick: nothing could follow it before."""
        return self if self.ramp is None else replace(self, moving=MovingReference(self.ramp, tick))

    def later(self, ticks: int) -> Self:
        """Return the same as many ticks later."""
        if self.moving is None:
            return self
        begin_tick = self.moving.begin_tick + ticks
        return replace(self, moving=MovingReference(self.moving.form, begin_tick))


def on_the_way(start: float, setpoint: float, slope: float, tick: int) -> AskedReference:
    """Return a set-point with the ramp to it; with a slope that is infinite in one step.

    Args:
        start: Where the reference is.
        setpoint: Where it goes.
        slope: Its change in one second.
        tick: Tick at which it leaves.
    """
    end = setpoint + 0.0  # without the sign of -0
    if slope == math.inf or start == end:
        return AskedReference(end)
    return AskedReference(end, MovingReference(Ramp(start, end, slope), tick))


# Limits of an operator's requests, and the refusals of values outside them.

_LONGEST_HOLD_S = 86_400.0
"""A day, as for the times of supervision in the configuration; None is no limit at all."""

FLOOR_REACHED = 0.99
"""Share of the floor of v_bst that ends `starting`: ripple and measurement differ by 1 %."""


def can_hold(reach: Reach, value: float) -> bool:
    """Return whether V_c can hold an output; True while the range is not known."""
    return not (value < reach.low or value > reach.high)


def coasts_at(setpoint: float, reach: Reach) -> bool:
    """Return whether a set-point lets the load coast: 0 or less, and V_c cannot hold it."""
    return setpoint <= 0.0 and not setpoint >= reach.low  # which may not be known


_SMALLEST, _LARGEST = 1e-9, 1e9
"""Slopes, distances and times in s that a program or a command may have: 1e9 s are 32 years."""

_PLAIN = Display()


def _require(  # noqa: PLR0913, PLR0917 - the parts of one sentence
    what: str, value: float, low: float, high: float, display: Display = _PLAIN, why: str = ""
) -> None:
    """Refuse a value that is not finite, or outside of a range; an end that is NaN is none."""
    if not math.isfinite(value) or value < low or value > high:
        allowed = display.range_text(low, high)
        raise RefusedError(f"{what} = {display.text(value, '.12g')} is outside {allowed}{why}")


def require_positive(what: str, value: float | None) -> None:
    """Refuse a value that is not finite and above 0, or of no use; None is one that is left out."""
    if value is None or _SMALLEST <= value <= _LARGEST:
        return
    allowed = f"outside {_SMALLEST:g}…{_LARGEST:g}"
    if not 0.0 < value < math.inf:
        allowed = "not a finite number above 0"
    raise RefusedError(f"{what} = {value:.12g} is {allowed}")


@dataclass(frozen=True, slots=True)
class MachineLimits:
    """Limits of an operator's requests, and of the time to start.

    Attributes:
        load: Its set-points, and the pole at start.
        drive: Its V_c.
        pole_min: Fastest pole whose fixed gains stand an error of the model.
        pole_max: Slowest such pole.
        period_min_s: Shortest period of a waveform.
        starting_ticks: Longest precharge, in fast ticks.
        rate_s: Longest wait for a known rate of the half cycles before it.
        reach: What V_c can hold by the nominal model.
    """

    load: LoadSection
    drive: DriveSection
    pole_min: float
    pole_max: float
    period_min_s: float
    starting_ticks: int
    rate_s: float
    reach: Reach = UNKNOWN

    @property
    def floor_V(self) -> float:
        """Boost voltage at which starting ends, and lowest V_c."""
        return self.drive.limits.boost_reference_min_V

    @property
    def rest_V(self) -> float:
        """V_c from which each run begins: 0 where it may be negative, else the lowest."""
        return max(self.floor_V, 0.0)

    @property
    def precharges(self) -> bool:
        """True where the lowest V_c is waited for, unlike a frequency of a drive that is off."""
        drive = self.drive
        return self.floor_V > 0.0 and (drive.boost_needs_bridge or drive.given.is_boost_voltage)

    def require_reference(self, what: str, value: float) -> None:
        """Refuse a set-point that the configuration does not allow.

        Args:
            what: Name of the value in the refusal.
            value: Set-point in the unit of the output.

        Raises:
            RefusedError: The value is out of range or not finite.
        """
        load = self.load
        _require(what, value, load.reference_min, load.reference_max, load.display)

    def require_reach(self, what: str, value: float, reach: Reach) -> None:
        """Refuse a set-point that V_c cannot hold.

        Arguments as of `require_reference`.
        """
        if not can_hold(reach, value):
            why = f", which {self.drive.given.symbol} can hold"
            _require(what, value, reach.low, reach.high, self.load.display, why)

    def require_setpoint(self, what: str, value: float, reach: Reach) -> None:
        """Refuse a set-point that is not allowed, or that V_c cannot hold and is no rest.

        Arguments as of `require_reach`.
        """
        self.require_reference(what, value)
        if not coasts_at(value, reach):
            self.require_reach(what, value, reach)

    def require_waveform(self, what: str, waveform: Waveform, reach: Reach) -> None:
        """Refuse a waveform that is not allowed, or that V_c cannot follow.

        Arguments as of `require_reach`.
        """
        for name, value in (("low", waveform.low), ("high", waveform.high)):
            self.require_reference(f"{what} {name}", value)
            self.require_reach(f"{what} {name}", value, reach)
        self.require_period(f"{what} period_s", waveform.period_s)

    def slope(self, asked: float | None) -> float:
        """Return the slope of the way to a set-point, in its unit per second, infinite for a step.

        Args:
            asked: What its command asks for, None for the configured one.
        """
        return (self.load.reference_slope or math.inf) if asked is None else asked

    def require_period(self, what: str, value: float) -> None:
        """Refuse a period of a waveform, in s, that is too short or too long."""
        if not value >= self.period_min_s:
            raise RefusedError(f"{what} = {value:.12g} s is below {self.period_min_s:g} s")
        require_positive(what, value)

    def require_pole(self, value: float) -> None:
        """Refuse a closed-loop pole that is too fast or too slow."""
        _require("pole", value, self.pole_min, self.pole_max)

    def require_voltage(self, value: float, hold_s: float | None) -> None:
        """Refuse a V_c, in V, or a time to hold it, in s, that is out of range."""
        given, highest_V = self.drive.given, self.drive.limits.boost_reference_max_V
        _require(given.by_hand, value, self.floor_V, highest_V, Display(given.unit))
        if hold_s is not None and not 0.0 < hold_s <= _LONGEST_HOLD_S:
            allowed = f"above 0 s and at most {_LONGEST_HOLD_S:g} s"
            raise RefusedError(f"hold_s = {hold_s:g} s is not {allowed}")

    def is_reached(self, boost_voltage_V: float) -> bool:
        """Return whether the lowest V_c is there, as far as it comes before the load is fed."""
        reached = boost_voltage_V >= FLOOR_REACHED * self.floor_V
        return reached or (not self.precharges and math.isfinite(boost_voltage_V))

    def nearest_reference(self, output: float) -> float:
        """Return the allowed set-point that is nearest to an output."""
        return min(max(output, self.load.reference_min), self.load.reference_max)

    def held(self, voltage_V: float, tick: int) -> ManualVoltage:
        """Return a V_c that stays, at the limit nearest to the given one."""
        limits = self.drive.limits
        held_V = min(max(self.floor_V, voltage_V), limits.boost_reference_max_V)
        slew_V = limits.manual_slew_V_per_s * self.drive.half_cycle_s
        return ManualVoltage(held_V, held_V, tick, slew_V)

    def precharge_cause(self, boost_voltage_V: float) -> Trip:
        """Return the cause of a trip in state `starting`, with the likeliest remedy."""
        passed_s, given = self.starting_ticks * self.drive.half_cycle_s, self.drive.given
        hint = (
            ", with its enable bit on"
            if self.drive.boost_needs_bridge
            else "; a boost stage that works only with the enable bit on needs drive.enable_bit = "
            "'bridge-and-boost'"
        )
        return Trip(
            TripKind.PRECHARGE,
            f"precharge: {given.name} = {given.text(boost_voltage_V, '.1f')} after "
            f"{passed_s:g} s, needs {given.text(self.floor_V, 'g')}{hint}; else the "
            "drive refuses the commands (checksum, counter, local instead of remote mode), or line "
            "or precharge circuit is open",
        )


# Settings of the runtime of one drive, and the interface of its fast loop to the rest.


@dataclass(frozen=True, slots=True)
class FastLoopSettings:
    """Settings of the fast loop.

    Attributes:
        limits: Trip levels.
        drive: Limits of what may be sent.
        timing: Times of the drive.
        latency_ticks: L, ticks from a snapshot to the effect of its decision.
        watches: Factories of the watches over the output, in the order of their causes.
        drive_clocks: Whether the drive decides when a reading comes.
        charges_capacitor: Whether this process charges the boost capacitor, and not the drive.
    """

    limits: Limits
    drive: DriveSection
    timing: Timing
    latency_ticks: int
    watches: tuple[Callable[[], plausibility.Watch], ...] = ()
    drive_clocks: bool = True
    charges_capacitor: bool = False


class LoopServices(Protocol):
    """Interfaces of the fast loop to the rest of the runtime; every call returns at once."""

    def now_s(self) -> float:
        """Monotonic time."""

    def arm(self, deadline_s: float) -> None:
        """Call `on_deadline` at a monotonic time."""

    def met_deadline(self, now_s: float) -> None:
        """Take note of a tick that was in time."""

    def ticked(self, report: reports.TickReport) -> None:
        """Take the report of a complete tick."""

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        """Queue a snapshot for the slow loop; False when it has fallen hopelessly behind."""

    def decided(self, snapshot: Snapshot, decision: Decision) -> None:
        """Take note of a decision that takes effect."""

    def not_stopped(self, problem: Trip) -> None:
        """Take note of a stop that the drive has not confirmed in time."""

    def run_ended(self) -> None:
        """Discard what was decided: the drive is no longer running."""
