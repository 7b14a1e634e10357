"""Waits of an experiment, and bounds of V_c: the movement that the credible loads predict.

Each of a grid of loads with two lags,

    y = y0 + K / ((1 + T1 s)(1 + T2 s)) u,        T1 > T2,

is fitted to all samples since rest by least squares in K and y0. A load is credible where its sum
of squares exceeds the least one by no more than nine times the variance of a sample, which is three
standard deviations of K (profile likelihood). The largest credible K of each gives the largest
movement that V_c can cause before it is taken back.
"""

import math

import numpy as np

from adaptdrive.commissioning.course import ExperimentCourse, Steps
from adaptdrive.identification.excerpt import Array
from adaptdrive.util.errors import CommissionError

# The waits of an experiment: until the load is at rest, and until a battery takes a current.

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


def until_rest(course: ExperimentCourse) -> Steps[None]:
    """Wait until two quarters of the time since now have the same mean.

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
        if _is_rest(course, elapsed_s, start):
            return
        next_s = began_s + 1.1 * elapsed_s


def _is_rest(course: ExperimentCourse, elapsed_s: float, start: float) -> bool:
    """Compare the last two quarters of a wait; where it is over, the course takes the rest."""
    target, record, time_s = course.target, course.record, course.time_s
    quarter_s, drift = 0.25 * elapsed_s, 0.0
    if target.battery is not None:
        quarter_s = min(quarter_s, 0.5 * target.patience_s)
        drift = _DRIFT * target.move
    middle = record.mean(time_s - 2.0 * quarter_s, time_s - quarter_s)
    last = record.mean(time_s - quarter_s, time_s)
    error = course.standard_error(quarter_s)
    response = min(abs(last - start), target.move)
    allowed = max(_RESTING * response, 3.0 * error, drift)
    if error <= _VISIBLE / 3.0 * target.move and abs(last - middle) <= allowed:
        course.rest, course.rest_samples = last, record.count(time_s - quarter_s, time_s)
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


# Loads that the samples of an experiment leave credible, and how far they would move the output.

_RATIO = 1.6
"""Ratio of two neighbouring time constants of the grid."""

_DISTINCT = 1.05
"""Ratio of the two time constants that stand for equal ones: the closed form needs two."""

_SIGMAS = 3.0
_LOOK_SHARE = 0.01
"""Time between two predictions, and shortest time constant, as a share of the shortest wait."""

_LONGEST = 60.0
"""Longest time constant, in shortest waits."""

_LARGEST_GAIN = 4.0
"""Largest credible gain before anything was measured, over the guess from the limits."""

_FLOOR = 0.01
"""Least standard deviation of a sample, as a share of the movement: the grid fits no better."""

_EDGE = 1.25
"""Predicted movement, in movements, at which V_c is taken back."""

_RAISED = 1.1
"""Predicted movement to which a step may lead."""

SLOWEST_SLEW_V_PER_S = 50.0
_TRIES = (1.0, 0.8, 0.65, 0.5)


class CredibleLoads:
    """The loads on a grid, fitted to what an experiment has shown since its rest."""

    def __init__(self, course: ExperimentCourse, base_V: float) -> None:
        """Make the grid, and take the samples at rest under a V_c, whose mean is y = 0."""
        target = course.target
        self._course, self._base_V, self._rest = course, base_V, course.rest
        self._highest, self._taken = 0.0, len(course.record.times_s)
        self._look_s = _LOOK_SHARE * target.patience_s
        longest_s = _LONGEST * target.patience_s
        count = math.ceil(math.log(longest_s / self._look_s) / math.log(_RATIO)) + 1
        taus_s = np.geomspace(self._look_s, longest_s, count)
        slow, fast = np.tril_indices(count)
        self._slow_s = np.where(slow == fast, _DISTINCT, 1.0) * taus_s[slow]
        self._fast_s = taus_s[fast]
        self._ratio = self._slow_s / (self._slow_s - self._fast_s)
        self._gain_max = _LARGEST_GAIN * target.first_gain
        self._least_variance = (_FLOOR * target.move) ** 2
        self._first, self._second = np.zeros(len(slow)), np.zeros(len(slow))
        self._count, self._outputs = float(course.rest_samples), 0.0
        self._squares = course.rest_samples * course.noise * course.noise
        self._sums = np.zeros((3, len(slow)))
        self._largest = np.full(len(slow), self._gain_max)
        self._decays = (0.0, self._first, self._second)

    @property
    def gain(self) -> float:
        """Largest credible K."""
        return float(self._largest.max())

    def heads_for_edge(self) -> bool:
        """Take the last samples; return whether V_c must be taken back now.

        A battery is not judged: its current jumps, and falls while it is charged.
        """
        course, record = self._course, self._course.record
        if course.target.battery is not None:
            return False
        first = self._taken
        duration_s = round(course.time_s - record.times_s[first - 1], 3)
        if duration_s < self._look_s:
            return False
        self._taken = len(record.times_s)
        fed = float(np.mean([self._fed(one) for one in record.voltages_V[first:]]))
        self._take(duration_s, fed, np.array(record.outputs[first:]) - self._rest)
        self._highest = max(self._highest, fed)
        edge = _EDGE * course.target.move
        if self.gain * self._highest <= edge:
            return False
        now_V = record.voltages_V[-1]
        reaction_s = self._look_s + 0.5 * abs(now_V - self._base_V) / SLOWEST_SLEW_V_PER_S
        return self._movement(self._fed(now_V), reaction_s) > edge

    def largest_step(self, step: float) -> float:
        """Return the largest share of a step of the input that is safe for a shortest wait."""
        target = self._course.target
        for share in _TRIES:
            if self._movement(share * step, target.patience_s) <= _RAISED * target.move:
                return share * step
        return 0.0

    def _fed(self, voltage_V: float) -> float:
        """Return the load's input above that at rest."""
        target = self._course.target
        return target.to_input(voltage_V) - target.to_input(self._base_V)

    def _take(self, duration_s: float, fed: float, outputs: Array) -> None:
        """Take the samples of a short time: its input, and a value for each sample, above rest."""
        self._first, self._second = self._after(duration_s, fed)
        count, total, response = len(outputs), float(outputs.sum()), self._second
        self._count += count
        self._outputs += total
        self._squares += float(outputs @ outputs)
        self._sums[0] += count * response
        self._sums[1] += count * response * response
        self._sums[2] += total * response
        self._largest = self._fit()

    def _movement(self, fed: float, duration_s: float) -> float:
        """Return the largest credible movement if an input acts for a time, and then none."""
        first, second = self._after(duration_s, fed)
        peak = np.maximum(second, self._peak(first, second))
        return float((self._largest * np.maximum(peak, self._second)).max())

    def _after(self, duration_s: float, fed: float) -> tuple[Array, Array]:
        """Return both states after an input has acted for a time."""
        slow, fast = self._decay(duration_s)
        gap = self._first - fed
        second = fed + (self._second - fed) * fast + gap * self._ratio * (slow - fast)
        return fed + gap * slow, second

    def _decay(self, duration_s: float) -> tuple[Array, Array]:
        """Return what a time leaves of both exponentials; most times are the same."""
        if self._decays[0] != duration_s:
            slow, fast = np.exp(-duration_s / self._slow_s), np.exp(-duration_s / self._fast_s)
            self._decays = (duration_s, slow, fast)
        return self._decays[1:]

    def _peak(self, first: Array, second: Array) -> Array:
        """Return the largest second state after the input has become 0."""
        a = first * self._ratio
        b = second - a
        with np.errstate(all="ignore"):
            turning = -b * self._slow_s / (a * self._fast_s)
            time_s = np.log(turning) / (1.0 / self._fast_s - 1.0 / self._slow_s)
            peak = a * np.exp(-time_s / self._slow_s) + b * np.exp(-time_s / self._fast_s)
        return np.where(np.isfinite(peak) & (first > second), peak, second)

    def _fit(self) -> Array:
        """Return the largest credible K of each load, 0 where the load is not credible."""
        responses, squares, products = self._sums
        spread = squares - responses * responses / self._count
        cross = products - responses * (self._outputs / self._count)
        total = self._squares - self._outputs * self._outputs / self._count
        spread = np.maximum(spread, 1e-300)
        gain = np.clip(cross / spread, 0.0, self._gain_max)
        losses = total - 2.0 * gain * cross + gain * gain * spread
        least = float(losses.min())
        variance = max(least / self._count, self._least_variance)
        slack = least + _SIGMAS * _SIGMAS * variance - losses
        largest = gain + np.sqrt(np.maximum(slack, 0.0) / spread)
        return np.where(slack >= 0.0, np.minimum(largest, self._gain_max), 0.0)
