"""Course of a quantity: a level, a line and a step through points that scatter by more than shown.

Points have a standard deviation each. What lies between them beyond that, such as a warm day, is a
second variance τ², the same for all, which follows from their residuals (R. DerSimonian and N.
Laird, Controlled Clinical Trials 7, 1986, doi:10.1016/0197-2456(86)90046-2). Residuals that
resemble their neighbours, with the correlation φ, widen a deviation by √((1 + φ)/(1 - φ)).
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

FEWEST = 4
"""Points of a line: two more than it has parameters."""

_SIDE = 3
"""Least points on each side of a step."""

_CLEAR = 20.0
"""Loss by which a step must explain points better than a line: odds of e^10, 22,000 to 1."""

_MOST_ALIKE = 0.9
"""Largest correlation of neighbours that few points can show."""

_REPEATED = 0.01
"""Weight of what repeats what was known, against an independent estimate."""

_LEAST_VARIANCE = 1e-300


@dataclass(frozen=True, slots=True)
class Point:
    """A value at a time.

    Attributes:
        time_s: The time.
        value: The value.
        std: Standard deviation of one estimate of it.
        count: Independent estimates behind it; 0 where it repeats what was known.
    """

    time_s: float
    value: float
    std: float
    count: float = 1.0


@dataclass(frozen=True, slots=True)
class Fit:
    """A straight line through points over their places, such as their times.

    Attributes:
        slope: Rise for each unit of the places.
        std: Its standard deviation.
        spread: τ.
        factor: Factor by which residuals that resemble their neighbours widen deviations.
        loss: Σ w r² of the residuals r with the weights w = 1/(σ² + τ²).
    """

    slope: float
    std: float
    spread: float
    factor: float
    loss: float


@dataclass(frozen=True, slots=True)
class Step:
    """A sudden change.

    Attributes:
        time_s: Time of the first point after it.
        before: Mean before it.
        change: Mean after it less that before.
        std: Standard deviation of the change.
    """

    time_s: float
    before: float
    change: float
    std: float


def pooled(points: Sequence[Point], width_s: float) -> list[Point]:
    """Return a point for each span of time that has any: their weighted mean, in its middle.

    Args:
        points: In the order of their times.
        width_s: Length of a span; spans are counted from time 0.
    """
    spans: dict[int, list[Point]] = {}
    for one in points:
        spans.setdefault(math.floor(one.time_s / width_s), []).append(one)
    return [_pool(found, (span + 0.5) * width_s) for span, found in spans.items()]


def _pool(points: Sequence[Point], time_s: float) -> Point:
    """Return the mean of points, no better known than one estimate where none is independent."""
    weights = [max(one.count, _REPEATED) / one.std**2 for one in points]
    value = math.fsum(w * one.value for w, one in zip(weights, points, strict=True))
    single = len(points) / math.fsum(one.std**-2.0 for one in points)
    count = max(1.0, math.fsum(one.count for one in points))
    return Point(time_s, value / math.fsum(weights), math.sqrt(single / count))


def mean(points: Sequence[Point], spread: float = 0.0, factor: float = 1.0) -> tuple[float, float]:
    """Return the weighted mean of points, one at least, and its standard deviation.

    Args:
        points: The points.
        spread: τ.
        factor: As of `Fit`.
    """
    weights = _weights(points, spread)
    total = math.fsum(weights)
    middle = math.fsum(w * one.value for w, one in zip(weights, points, strict=True)) / total
    return middle, factor / math.sqrt(total)


def fit_line(points: Sequence[Point]) -> Fit | None:
    """Return the line through points over their times, None for fewer than four."""
    return _fit(points, [one.time_s for one in points]) if len(points) >= FEWEST else None


def find_step(points: Sequence[Point], sigmas: float) -> Step | None:
    """Return the step that explains points clearly better than a line does, None without one.

    Args:
        points: In the order of their times.
        sigmas: Least size of it, in its standard deviations.
    """
    found, times_s = list[tuple[float, Step]](), [one.time_s for one in points]
    for place in range(_SIDE, len(points) - _SIDE + 1):
        fit = _fit(points, [float(number >= place) for number in range(len(points))])
        weights = _weights(points, fit.spread)
        lead = _line(points, times_s, weights)[2] - fit.loss
        if lead > _CLEAR and abs(fit.slope) > sigmas * fit.std:
            before, _ = mean(points[:place], fit.spread)
            found.append((lead, Step(points[place].time_s, before, fit.slope, fit.std)))
    return max(found, key=lambda one: one[0])[1] if found else None


def _fit(points: Sequence[Point], places: Sequence[float]) -> Fit:
    plain = _weights(points, 0.0)
    total = math.fsum(plain)
    free = total - math.fsum(w * w for w in plain) / total
    excess = _line(points, places, plain)[2] - (len(points) - 2)
    spread = math.sqrt(max(0.0, excess) / free)
    weights = _weights(points, spread)
    slope, moment, loss, factor = _line(points, places, weights)
    return Fit(slope, factor / math.sqrt(moment), spread, factor, loss)


def _weights(points: Sequence[Point], spread: float) -> list[float]:
    return [1.0 / max(one.std * one.std + spread * spread, _LEAST_VARIANCE) for one in points]


def _line(
    points: Sequence[Point], places: Sequence[float], weights: Sequence[float]
) -> tuple[float, float, float, float]:
    """Return the slope of a weighted line, Σ w (x - x̄)², Σ w r², and the factor of correlation."""
    total = math.fsum(weights)
    middle = math.fsum(w * x for w, x in zip(weights, places, strict=True)) / total
    level = math.fsum(w * p.value for w, p in zip(weights, points, strict=True)) / total
    offsets = [x - middle for x in places]
    moment = math.fsum(w * x * x for w, x in zip(weights, offsets, strict=True))
    rows = list(zip(weights, offsets, (one.value - level for one in points), strict=True))
    slope = math.fsum(w * x * y for w, x, y in rows) / moment
    scaled = [math.sqrt(w) * (y - slope * x) for w, x, y in rows]
    loss = math.fsum(one * one for one in scaled)
    return slope, moment, loss, _factor(scaled, loss)


def _factor(scaled: Sequence[float], loss: float) -> float:
    if loss == 0.0:
        return 1.0
    alike = math.fsum(one * other for one, other in itertools.pairwise(scaled)) / loss
    alike = min(max(0.0, alike), _MOST_ALIKE)
    return math.sqrt((1.0 + alike) / (1.0 - alike))
