"""Bounds of V_c: the movement that the credible loads predict, kept within the band."""

from __future__ import annotations

import numpy as np

from adaptdrive.commission.course import ExperimentCourse
from adaptdrive.commission.credible import CredibleLoads
from adaptdrive.commission.rest import Rest

LARGEST_GAIN = 4.0
"""Largest credible gain before anything was measured, over the guess from the limits."""

EDGE = 1.25
"""Predicted movement, in movements, at which V_c is taken back."""

_RAISED = 1.1
"""Predicted movement to which a step may lead."""

_LOOK_SHARE = 0.01
"""Time between two predictions, as a share of the shortest wait."""

_HORIZON = 1.0
"""Time for which a step must be safe, in shortest waits."""

_SLOWEST_SLEW_V_PER_S = 50.0
_LONGEST = 60.0
"""Longest time constant, in shortest waits."""

_FLOOR = 0.01
"""Least standard deviation of a sample, as a share of the movement: the grid fits no better."""

_TRIES = (1.0, 0.8, 0.65, 0.5)


class Bounds:
    """The credible loads of an experiment since its rest."""

    def __init__(self, course: ExperimentCourse, base_V: float, rest: Rest) -> None:
        """Begin at rest.

        Args:
            course: The experiment.
            base_V: V_c at rest.
            rest: The rest.
        """
        target = course.target
        self._course = course
        self._base_V = base_V
        self._base = target.to_input(base_V)
        self._rest = rest.output
        self._highest = 0.0
        self._taken = len(course.record.times_s)
        self._look_s = _LOOK_SHARE * target.patience_s
        self._loads = CredibleLoads(
            shortest_s=self._look_s,
            longest_s=_LONGEST * target.patience_s,
            gain_max=LARGEST_GAIN * target.first_gain,
            deviation_min=_FLOOR * target.move,
        )
        self._loads.rest(rest.count, course.noise)

    @property
    def gain(self) -> float:
        """Largest credible gain."""
        return self._loads.gain

    def heads_for_edge(self) -> bool:
        """Take the last samples; return whether V_c must be taken back now."""
        course, record = self._course, self._course.record
        first = self._taken
        duration_s = round(course.time_s - record.times_s[first - 1], 3)
        if duration_s < self._look_s:
            return False
        self._taken = len(record.times_s)
        fed = float(np.mean([self._fed(one) for one in record.voltages_V[first:]]))
        outputs = np.array(record.outputs[first:]) - self._rest
        self._loads.take(duration_s, fed, outputs)
        self._highest = max(self._highest, fed)
        edge = EDGE * course.target.move
        if self._loads.gain * self._highest <= edge:
            return False
        now_V = record.voltages_V[-1]
        reaction_s = self._look_s + 0.5 * abs(now_V - self._base_V) / _SLOWEST_SLEW_V_PER_S
        return self._loads.movement(self._fed(now_V), reaction_s) > edge

    def largest_step(self, step: float) -> float:
        """Return the largest share of a step of the input that is safe for a shortest wait."""
        target = self._course.target
        horizon_s = _HORIZON * target.patience_s
        for share in _TRIES:
            if self._loads.movement(share * step, horizon_s) <= _RAISED * target.move:
                return share * step
        return 0.0

    def _fed(self, voltage_V: float) -> float:
        return self._course.target.to_input(voltage_V) - self._base
