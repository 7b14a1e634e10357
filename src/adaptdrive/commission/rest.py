"""The waits of an experiment: until the load is at rest, and until a battery takes a current."""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.commission.course import ExperimentCourse, Steps
from adaptdrive.util.errors import CommissionError

_DRIFT = 0.1
"""Change of a battery's current that counts as rest, as a share of the movement: its EMF rises."""

_RESTING = 0.05
"""Change over a quarter of the wait, as a share of the movement, of a load at rest."""

_VISIBLE = 0.06
"""Three standard errors of a rest, as a share of the movement, that are waited for."""

_PATIENCES = 60.0
"""Longest wait, in shortest ones."""

_FLOWING = 3.0
"""Current that can be lowered again, in movements."""

_BEHIND = 1.5
"""Distance from the voltage that was asked for, in steps, at which the next step waits."""

_WAIT_SHARE = 0.02
"""Wait after each step, as a share of the shortest wait for a response."""


@dataclass(slots=True)
class Rest:
    """Output at which a load came to rest; NaN until it has.

    Attributes:
        output: Mean output over the last quarter of the wait.
        count: Samples of that quarter.
    """

    output: float = float("nan")
    count: int = 0


def until_rest(course: ExperimentCourse, rest: Rest) -> Steps[None]:
    """Wait until two quarters of the time since now have the same mean.

    Args:
        course: The experiment.
        rest: Takes the rest.

    Raises:
        CommissionError: The load does not come to rest, or its output is too large.
    """
    began_s, start = course.time_s, course.recent(course.smooth_s)
    next_s = began_s + course.wait_s
    while True:
        yield True
        course.look_at_output()
        if course.time_s < next_s:
            continue
        elapsed_s = course.time_s - began_s
        if _is_rest(course, elapsed_s, start, rest):
            return
        next_s = began_s + 1.1 * elapsed_s


def _is_rest(course: ExperimentCourse, elapsed_s: float, start: float, rest: Rest) -> bool:
    """Compare the last two quarters of a wait."""
    target, record, time_s = course.target, course.record, course.time_s
    quarter_s, drift = 0.25 * elapsed_s, 0.0
    if target.onset is not None:
        quarter_s = min(quarter_s, 0.5 * target.patience_s)
        drift = _DRIFT * target.move
    middle = record.mean(time_s - 2.0 * quarter_s, time_s - quarter_s)
    last = record.mean(time_s - quarter_s, time_s)
    error = course.standard_error(quarter_s)
    response = min(abs(last - start), target.move)
    allowed = max(_RESTING * response, 3.0 * error, drift)
    if error <= _VISIBLE / 3.0 * target.move and abs(last - middle) <= allowed:
        rest.output, rest.count = last, record.count(time_s - quarter_s, time_s)
        return True
    if elapsed_s > _PATIENCES * target.patience_s:
        raise CommissionError(
            f"{target.name} does not come to rest within {elapsed_s:.0f} s: it moves by "
            f"{last - middle:.3g} {target.unit} in {quarter_s:.0f} s, and its noise "
            f"is {record.noise(time_s - elapsed_s, time_s):.3g} {target.unit}"
        )
    return False


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
                f"{target.given.text(voltage_V)}, the highest {target.given.symbol}"
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
