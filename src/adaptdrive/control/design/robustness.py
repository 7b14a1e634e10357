"""Assurance: how far the loop that new gains make may differ from the one asked for.

The design is right for the estimate itself; the load may lie anywhere within its covariance. What
matters of that is the loop. With L Lᵀ the covariance of the physical parameters p, the loads

    p ± c l_j        l_j the columns of L, c the confidence

are closed with the proposed gains. A loop that one of them makes unstable, with a margin, is not
to be had. Otherwise the square root of the sum over j of the squared differences from the response
of the estimate, at the slow sample where it is largest, is how far the response to a step may be
off. To first order it is c standard deviations of the response.

A parameter that the response hardly depends on, such as a short second lag, may be as uncertain as
it likes. Parameters that the samples leave open along a direction that the loop does not see, such
as a gain and time constants that grow together, count for what they do together.
"""

from __future__ import annotations

import math

from adaptdrive.control.design.pole_placement import (
    asked_loop,
    closed_loop_polynomial,
    discrete_model,
)
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.thresholds import NOISE_FLOOR, WINDOW
from adaptdrive.control.vectors import Vector, all_finite, is_stable, total

STABLE_RADIUS = 1.0 - math.sqrt(NOISE_FLOOR)
"""Largest pole of a possible load that is stable: in one of 10,000 slow periods it loses less than
the least noise."""

_SMALLEST_SHARE = 0.05
"""Least share of a parameter that is tried: physical parameters are positive."""

_LONGEST = 10 * WINDOW
"""Samples of a response that are compared at most: twice the delay of four poles at 0.96."""

MARGIN_RADIUS = 1.0 - 1.0 / _LONGEST
"""Largest pole of the loop with a possible load: as slow as the longest response."""


def possible_models(
    settings: ControllerSettings, load: Load, values: Vector, root: Vector, period_s: float
) -> Vector:
    """Return A and B of the estimate, and of p + c l_j and p - c l_j for each j, in one vector.

    Args:
        settings: Design, and the confidence.
        load: The load.
        values: Estimated physical parameters p.
        root: L, flat, square.
        period_s: T_k.

    Returns:
        The models; NaN alone where nothing is known of the covariance.
    """
    if not all_finite(root):
        return [math.nan]
    count, confidence = len(values), settings.jacket.confidence
    models = _model(settings, load, values, period_s)
    for j in range(count):
        for sign in (confidence, -confidence):
            vertex = _moved(values, root, j, sign)
            models = [*models, *_model(settings, load, vertex, period_s)]
    return models


def _model(settings: ControllerSettings, load: Load, values: Vector, period_s: float) -> Vector:
    numerator, denominator = load.realise(values)
    a, b = discrete_model(settings, load, numerator, denominator, period_s)
    return [*a, *b]


def response_spread(
    order: int, models: Vector, gains: Vector, loop: Vector, model_b: Vector, pole: float
) -> float:
    """Return how far the response to a step may be off, as a share of the step.

    Args:
        order: m.
        models: Those of `possible_models`.
        gains: r_1 ... r_n, s_0 ... s_m.
        loop: A_c, which they give the estimate.
        model_b: B of the estimate.
        pole: Pole asked for.

    Returns:
        The share; infinite where a load within the covariance makes the loop unstable, or nothing
        is known of it.
    """
    if math.isnan(models[0]):
        return math.inf
    size = order + 1 + len(model_b)
    driven = _driven(order, gains, loop, model_b, pole)
    own = _response(order, models[:size], gains, driven)
    squares = [0.0] * len(own)
    for first in range(size, len(models), 2 * size):
        largest = [0.0] * len(own)
        for begin in (first, first + size):
            other = _response(order, models[begin : begin + size], gains, driven)
            for i in range(len(own)):
                largest[i] = max(largest[i], abs(other[i] - own[i]))
        for i in range(len(own)):
            squares[i] += largest[i] * largest[i]
    return math.sqrt(max(squares))


def closes_stably(gains: Vector, a: Vector, b: Vector, order: int, radius: float) -> bool:
    """Return whether gains and a model A, B make a loop whose poles lie within a circle.

    Args:
        gains: r_1 ... r_n, s_0 ... s_m.
        a: A of the model.
        b: B of the model.
        order: m.
        radius: Of the circle about 0.
    """
    polynomial = closed_loop(gains, a, b, order)
    return all_finite(polynomial) and is_stable(polynomial, radius)


def closed_loop(gains: Vector, a: Vector, b: Vector, order: int) -> Vector:
    """Return A_c of the loop that gains and a model A, B make."""
    taps = len(gains) - order - 1
    return closed_loop_polynomial(a, b, [1.0, *gains[:taps]], gains[taps:])


def _moved(values: Vector, root: Vector, column: int, factor: float) -> Vector:
    """p + factor · l_j, where every parameter stays positive."""
    count, vertex = len(values), list(values)
    for i in range(count):
        moved = values[i] + factor * root[i * count + column]
        vertex[i] = max(moved, _SMALLEST_SHARE * values[i])
    return vertex


def _driven(order: int, gains: Vector, loop: Vector, b: Vector, pole: float) -> Vector:
    """t0 r" of a unit step behind the reference filter, until the response has settled."""
    asked = asked_loop(b, order, pole)
    count = min(_LONGEST, round(4.0 * order * pole / (1.0 - pole)) + len(b))
    course = _filtered([total(asked)], asked, [1.0] * count)
    share = total(gains[len(gains) - order - 1 :]) / total(loop)
    return _filtered([share * one for one in loop], [1.0], course)


def _response(order: int, model: Vector, gains: Vector, driven: Vector) -> Vector:
    """y[k] of a load in the loop of some gains; infinite where that is not stable."""
    a, b = model[: order + 1], model[order + 1 :]
    closed = closed_loop(gains, a, b, order)
    if not (all_finite(closed) and is_stable(closed, MARGIN_RADIUS)):
        return [math.inf] * len(driven)
    return _filtered(b, closed, driven)


def _filtered(numerator: Vector, denominator: Vector, signal: Vector) -> Vector:
    """A signal behind a filter in q^-1 that begins at rest."""
    result = [0.0] * len(signal)
    for k in range(len(signal)):
        value = 0.0
        for i in range(min(k + 1, len(numerator))):
            value += numerator[i] * signal[k - i]
        for i in range(1, min(k + 1, len(denominator))):
            value -= denominator[i] * result[k - i]
        result[k] = value
    return result
