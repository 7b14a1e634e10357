"""One course with one fault, judged: its reaction, and what has held since."""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.runtime.reports import State
from tests.integration.faults.course import AFTER_s, Course, example, honest
from tests.integration.faults.rows import Row

BOOST_MAX_V = 460.0
"""The drive's own over-voltage is at 450 V."""

_SAFE_HALF_CYCLES = 3


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a fault did.

    Attributes:
        reaction_s: From the fault to the trip, infinite without one.
        trip: Cause of the trip.
        excess: Highest output over `interlocks.output_max`.
        flaws: What did not hold.
        enables: How often the drive had to be enabled after the fault, 0 where that was not tried.
    """

    reaction_s: float
    trip: str
    excess: float
    flaws: tuple[str, ...]
    enables: int = 0


def judge(row: Row, name: str, seed: int) -> Verdict | None:
    """Run one course; None when the daemon refuses the load before any fault."""
    tables = example(name)
    if row.stale_s is not None:
        tables["interlocks"]["stale_s"] = row.stale_s
    course = Course(name, seed, tables)
    if row.from_start:
        _put(row, course)
    if not course.begin():
        return None
    began_s = course.daemon.now
    if not row.from_start:
        _put(row, course)
    if row.step:
        course.run(1.0, until_trip=True)
        course.step_setpoint()
    bound_s = (row.bound_s or {}).get(course.load, AFTER_s[course.load])
    course.run(1.2 * bound_s, until_trip=True)
    tripped = course.daemon.state is State.TRIPPED
    reaction_s = course.daemon.now - began_s if tripped else math.inf
    trip = course.daemon.trip or ""
    excess = course.highest / course.configuration.interlocks.output_max
    flaws, enables = _flaws(row, course, reaction_s), 0
    if tripped:
        flaws += _after_a_trip(row, course)
        if row.mends:
            mend(course)
            enables = course.recovers()
            flaws += [] if enables else [f"does not run again: {course.daemon.trip}"]
    return Verdict(reaction_s, trip, excess, tuple(flaws), enables)


def _put(row: Row, course: Course) -> None:
    course.fault_s = course.daemon.now
    row.put(course)


def _flaws(row: Row, course: Course, reaction_s: float) -> list[str]:
    """What contradicts the row: a value, the time, or the cause."""
    found = [] if course.highest_V < BOOST_MAX_V else [f"v_bst {course.highest_V:.0f} V"]
    bound_s = None if row.bound_s is None else row.bound_s.get(course.load)
    trip = course.daemon.trip or ""
    if bound_s is not None and not reaction_s <= bound_s:
        found.append("late" if reaction_s < math.inf else "no trip")
    if row.causes and trip and not trip.startswith(row.causes):
        found.append(f"names {trip[:40]!r}")
    if not row.causes and trip:
        found.append(f"tripped: {trip[:40]!r}")
    return found


def _after_a_trip(row: Row, course: Course) -> list[str]:
    """What is not off, or not commanded off."""
    course.run(_SAFE_HALF_CYCLES * course.stride * course.drive.world.line.half_cycle_s)
    found = [] if course.commands[-1] == SAFE_COMMAND else ["not commanded off"]
    course.run(1.5)
    return found if course.off or row.sticks_on else [*found, "not off"]


def mend(course: Course) -> None:
    """End the fault."""
    course.sensor, course.lags, course.decides = honest, 0, True
    course.actuator = lambda command: command
    course.frame = lambda reading: reading
    course.daemon.port.trip_cause = None
