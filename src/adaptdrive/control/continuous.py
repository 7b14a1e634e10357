"""From a discrete model back to the continuous-time load, for orders 1 and 2.

The poles z_i of A give those of the load, s_i = ln(z_i)/T; the gain follows from that at rest,
B(1)/A(1). The parameters that direct least squares publishes follow from it. Written in sums and
products of logarithms, so that a complex pair needs no complex numbers.
"""

from __future__ import annotations

import math

from adaptdrive.control.vectors import Vector, total


def continuous_model(a: Vector, b: Vector, period_s: float) -> tuple[Vector, Vector]:
    """The load without zeros that has the poles and the gain of a discrete model.

    Args:
        a: A in q^-1, first entry 1.
        b: B in q^-1.
        period_s: T.

    Returns:
        Numerator and denominator in s, highest power first; NaNs where there is no such load
        (a negative real pole, a pole at 0, an order above 2) or it has no gain.
    """
    order = len(a) - 1
    denominator = _denominator(a, period_s)
    numerator = [0.0] * (order + 1)
    rest = total(a)
    numerator[order] = denominator[order] * total(b) / rest if rest else math.nan
    return numerator, denominator


def _denominator(a: Vector, period_s: float) -> Vector:
    unknown = [1.0] + [math.nan] * (len(a) - 1)
    if len(a) == 2:
        return [1.0, -math.log(-a[1]) / period_s] if a[1] < 0.0 else unknown
    if len(a) != 3 or a[2] <= 0.0:
        return unknown
    middle, square = -0.5 * a[1], 0.25 * a[1] * a[1] - a[2]
    if square >= 0.0:
        split = math.sqrt(square)
        if middle - split <= 0.0:
            return unknown
        product = math.log(middle + split) * math.log(middle - split)
    else:
        angle = math.atan2(math.sqrt(-square), middle)
        product = 0.25 * math.log(a[2]) ** 2 + angle * angle
    return [1.0, -math.log(a[2]) / period_s, product / period_s**2]
