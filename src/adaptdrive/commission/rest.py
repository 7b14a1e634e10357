"""The wait of an experiment until the load is at rest."""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.commission.course import ExperimentCourse
from adaptdrive.commission.phases import Steps
from adaptdrive.errors import CommissionError

_DRIFT = 0.1
"""Change of a battery's current that counts as rest, as a share of the movement: its EMF rises."""

_RESTING = 0.05
"""Change over a quarter of the wait, as a share of the movement, of a load at rest."""

_VISIBLE = 0.06
"""Three standard errors of a rest, as a share of the movement, that are waited for."""

_PATIENCES = 60.0
"""Longest wait, in shortest ones."""


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
