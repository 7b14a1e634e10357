"""Stability of new gains within the uncertainty of the estimate.

The design is right for the estimate itself. The load may lie anywhere in the estimate's confidence
ellipsoid; its extreme points along the physical parameters stand for it: one parameter at a time,
up and down by some standard deviations. The gains must keep each of those loads stable with a
margin, and the last trusted model too, unless an abrupt change has made that one history.

A parameter that is known to within a few percent is not tried: the gain and phase margins of a
loop with equal real poles are far wider than that.
"""

from __future__ import annotations

from adaptdrive.control.design import discrete_model
from adaptdrive.control.load import Load
from adaptdrive.control.pole_placement import closed_loop_polynomial
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.vectors import Vector, all_finite, is_stable

SURE = 0.03
"""Relative standard deviation below which a parameter need not be tried."""

MARGIN_RADIUS = 0.995
"""Largest pole of the loop with a possible load: a time constant of 200 slow periods."""

STABLE_RADIUS = 0.9999
"""Largest pole of a possible load that is stable: 10,000 slow periods."""

_SMALLEST_SHARE = 0.05
"""Least share of a parameter that is tried: physical parameters are positive."""


def stands_uncertainty(
    settings: ControllerSettings,
    load: Load,
    gains: Vector,
    values: Vector,
    deviations: Vector,
    period_s: float,
) -> bool:
    """Return whether gains keep the load stable wherever its parameters may be.

    Args:
        settings: Design, and how many standard deviations to try; 0 tries none.
        load: The load.
        gains: r_1 ... r_n, s_0 ... s_m.
        values: Estimated physical parameters.
        deviations: Their standard deviations, NaN where unknown: those are not tried.
        period_s: T_k.
    """
    confidence = settings.jacket.confidence
    if not confidence > 0.0:
        return True
    for i in range(len(values)):
        if values[i] == 0.0:  # a direct term that the model has not: any share of it is 0, too
            continue
        share = deviations[i] / abs(values[i])
        if not share > SURE:
            continue
        for factor in (1.0 + confidence * share, 1.0 - confidence * share):
            vertex = list(values)
            vertex[i] *= max(factor, _SMALLEST_SHARE)
            numerator, denominator = load.realise(vertex)
            a, b = discrete_model(settings, load, numerator, denominator, period_s)
            if not closes_stably(gains, a, b, load.order, MARGIN_RADIUS):
                return False
    return True


def closes_stably(gains: Vector, a: Vector, b: Vector, order: int, radius: float) -> bool:
    """Return whether gains and a model A, B make a loop whose poles lie within a circle.

    Args:
        gains: r_1 ... r_n, s_0 ... s_m.
        a: A of the model.
        b: B of the model.
        order: m.
        radius: Of the circle about 0.
    """
    taps = len(gains) - order - 1
    polynomial = closed_loop_polynomial(a, b, [1.0, *gains[:taps]], gains[taps:])
    return all_finite(polynomial) and is_stable(polynomial, radius)
