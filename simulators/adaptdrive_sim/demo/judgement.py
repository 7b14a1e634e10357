"""Verdict on control, from the received messages and the response of the ideal loop."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from adaptdrive.watch.plot import PlotPoint
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.settings import HIGH_V, LOW_V

STEP_V = HIGH_V - LOW_V
TRACKING_LIMIT = 0.3
"""Largest rms distance from the ideal response, as a fraction of the wave's step."""

TICKS_SHARE = 0.95
TICK_RATE_Hz = 120.0
JUDGED_PERIODS = 60
_BETWEEN_SAMPLES = 0.93
"""Zero of the motor's held model: how the response shares a step between two samples."""


def ideal_response(points: Sequence[PlotPoint], pole: float) -> list[float]:
    """Speed at the slow instants if the closed loop had its four poles where they are asked for.

    Args:
        points: Reference and speed of the slow periods; the first is taken as at rest.
        pole: Closed-loop pole in the z-plane of the slow rate.
    """
    if not points:
        return []
    rest = points[0].output
    earlier = [rest] * 4
    gain = (1.0 - pole) ** 4 / (1.0 + _BETWEEN_SAMPLES)
    references = [rest, rest, *(point.reference for point in points)]
    response = []
    for k in range(len(points)):
        pushed = references[k + 1] + _BETWEEN_SAMPLES * references[k]
        value = gain * pushed + _recall(earlier, pole)
        earlier = [value, *earlier[:3]]
        response.append(value)
    return response


def _recall(earlier: Sequence[float], pole: float) -> float:
    """Return the contribution of four earlier values to (1 - p/z)^4."""
    weights = (4.0 * pole, -6.0 * pole**2, 4.0 * pole**3, -(pole**4))
    return sum(weight * value for weight, value in zip(weights, earlier, strict=True))


def tracking_error(record: DemoRecord) -> float:
    """Rms distance from the ideal response over the last minute.

    It is a fraction of the wave's step, or of the span of the set-point where that is larger.

    Returns:
        NaN when nothing was controlled.
    """
    points = list(record.slow)
    if not points or record.state is None:
        return math.nan
    ideal = ideal_response(points, record.state.pole)
    errors = [point.output - value for point, value in zip(points, ideal, strict=True)]
    judged = errors[-JUDGED_PERIODS:]
    references = [point.reference for point in points[-JUDGED_PERIODS:]]
    span = max(STEP_V, max(references) - min(references))
    return math.sqrt(sum(error * error for error in judged) / len(judged)) / span


def shortcomings(record: DemoRecord) -> Iterator[str]:
    """Everything that makes the demonstration a failure, in one sentence each."""
    counts = record.control
    if counts is None:
        yield "the drive never ran"
        return
    yield from (f"tripped: {cause}" for cause in record.trips)
    if not record.running:
        state = record.state.state if record.state else "unknown"
        yield f"the drive is not running but in {state}"
    expected = TICK_RATE_Hz * counts.time_s
    if counts.ticks < TICKS_SHARE * expected:
        yield f"only {counts.ticks} of {expected:.0f} ticks were run"
    error = tracking_error(record)
    if math.isnan(error):
        yield "the controller has not decided yet, so that nothing was controlled"
    elif error > TRACKING_LIMIT:
        yield f"the speed is {error:.2f} of a step (rms) from where it should be"
