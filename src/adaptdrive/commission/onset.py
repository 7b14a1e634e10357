"""The search for the voltage at which a battery takes a current."""

from __future__ import annotations

from adaptdrive.commission.course import ExperimentCourse
from adaptdrive.commission.phases import Steps
from adaptdrive.errors import CommissionError

_FLOWING = 3.0
"""Current that can be lowered again, in movements."""

_BEHIND = 1.5
"""Distance from the voltage that was asked for, in steps, at which the next step waits."""

_WAIT_SHARE = 0.02
"""Wait after each step, as a share of the shortest wait for a response."""


def find_onset(course: ExperimentCourse) -> Steps[float]:
    """Raise V_c until a current flows that can be lowered again, and return it.

    Raises:
        CommissionError: No current flows, or the voltage at the terminals would be too high.
    """
    target = course.target
    wanted, wait_s = _FLOWING * target.move, _WAIT_SHARE * target.patience_s
    voltage_V = target.low_V
    yield from course.wait(target.patience_s / 4.0)
    while course.recent(wait_s) < wanted:
        if voltage_V >= target.high_V:
            raise CommissionError(
                f"no current: {target.name} = {course.recent(wait_s):.3g} {target.unit} at "
                f"{voltage_V:.4g} V, the highest V_c"
            )
        voltage_V = min(voltage_V + target.onset_step_V, target.high_V)
        course.voltage_V = voltage_V
        course.found = (voltage_V - target.low_V) / (target.high_V - target.low_V)
        course.look_at_terminals(voltage_V, course.recent(wait_s))
        yield from _arrive(course, voltage_V)
        yield from course.wait(wait_s)
    return voltage_V


def _arrive(course: ExperimentCourse, voltage_V: float) -> Steps[None]:
    """Wait until the drive has come near a voltage; a command takes its time to reach it."""
    nearly_V = voltage_V - _BEHIND * course.target.onset_step_V
    until_s = course.time_s + course.target.patience_s
    while course.record.voltages_V[-1] < nearly_V and course.time_s < until_s:
        yield True
        course.look_at_output()
