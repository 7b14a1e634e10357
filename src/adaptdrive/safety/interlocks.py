"""Limits of one reading: its age, its values, the drive's own fault.

Each check gives the trip, or None. A trip is latched by the state machine; `reset` is refused while
a cause is still there.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from adaptdrive.config.bus import MEASURED
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.quantity import BOOST, Given


@dataclass(frozen=True, slots=True)
class Limits:
    """Trip levels.

    Attributes:
        boost_voltage_max_V: Over-voltage.
        output_max: Highest output.
        output_unit: Unit of the output, for the text of the trip.
        output_name: Name of the output, as above.
        output_min: Lowest output.
        absent: Quantities that nobody measures.
        given: Name and unit of what the drive gives, for the text of the trip.
    """

    boost_voltage_max_V: float
    output_max: float
    output_unit: str
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
    unit = f" {limits.output_unit}" if limits.output_unit else ""
    return f"{limits.output_name} = {output:.4g}{unit}, limit {limit:g}{unit}"


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


def fault_trip(word: int, name: str) -> Trip:
    """Return the trip for a fault of the drive.

    Args:
        word: The drive's fault word.
        name: Its name, empty for none.
    """
    coded = f"word {word:#x}"
    text = f"drive fault: {name} ({coded})" if name else f"drive fault: {coded}"
    return Trip(TripKind.DRIVE_FAULT, text)
