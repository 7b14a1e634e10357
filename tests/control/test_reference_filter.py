"""The response to the reference, whatever the poles of the loop are."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from adaptdrive.control.compensator import control_law
from adaptdrive.control.design import asked_loop, discrete_model, loop_gains
from adaptdrive.control.noise_limit import slowed_loop
from adaptdrive.control.pole_placement import equation
from adaptdrive.control.reference_filter import (
    ReferenceFilter,
    condition_reference,
    filter_reference,
    new_reference_filter,
)
from adaptdrive.control.vectors import copy_into
from tests.closed_loop.bench import EXACT, MOTOR
from tests.control.systems import Array, motor_system

POLE, REST, FAR = 0.7, 3.0, 3.8
REST_V = REST / 0.011
SYSTEM = motor_system(3)
A, B = discrete_model(EXACT, MOTOR, SYSTEM.numerator, SYSTEM.denominator, 1.0)
TAPS = len(B) - 1
ASKED = asked_loop(B, MOTOR.order, POLE)


def slow_loop(slowness: float) -> list[float]:
    return slowed_loop([1.0], MOTOR.order, TAPS - MOTOR.order, POLE, slowness)


def designed(slowness: float) -> ReferenceFilter:
    state = new_reference_filter(MOTOR.order, TAPS)
    filter_reference(state, REST)
    copy_into(state.asked, ASKED)
    copy_into(state.loop, slow_loop(slowness))
    return state


def response(
    slowness: float, target: float, limit_V: float = math.inf, *, conditioned: bool = True
) -> Array:
    """Output after a step of the reference, on the discrete model."""
    state, gains = designed(slowness), loop_gains(equation(A, B), A, B, slow_loop(slowness))
    inputs, outputs, trace = [REST_V] * TAPS, [REST] * (MOTOR.order + 1), []
    for _ in range(200):
        y = np.dot(B[1:], inputs) - np.dot(A[1:], outputs[: MOTOR.order])
        outputs = [float(y), *outputs[:-1]]
        wanted = control_law(gains, inputs, outputs, filter_reference(state, target))
        applied = min(wanted, limit_V)
        if conditioned:
            condition_reference(state, applied - wanted, sum(gains[TAPS:]))
        inputs = [applied, *inputs[:-1]]
        trace.append(outputs[0])
    return np.array(trace)


def ideal(target: float) -> Array:
    """B/B(1) A_m(1)/A_m."""
    step = np.full(200, target - REST)
    weights = np.array(B) * sum(ASKED) / sum(B)
    return np.asarray(REST + lfilter(weights, ASKED, step))


@pytest.mark.parametrize("slowness", [0.0, 0.5, 1.0, 1.6, 2.0])
def test_the_response_to_the_reference_is_the_one_asked_for(slowness: float) -> None:
    assert response(slowness, 3.2) == pytest.approx(ideal(3.2), abs=1e-6)


def test_a_loop_with_the_asked_poles_gets_the_reference_itself() -> None:
    state = designed(0.0)
    given = np.random.default_rng(1).uniform(2.0, 4.0, 50)
    found = []
    for reference in given:
        found.append(filter_reference(state, float(reference)))
        condition_reference(state, -20.0, 5e3)
    assert found == pytest.approx(given.tolist(), rel=1e-9)


@pytest.mark.parametrize("slowness", [0.5, 1.0, 2.0])
def test_after_a_limit_the_output_arrives_as_soon_as_in_the_loop_that_was_asked_for(
    slowness: float,
) -> None:
    asked, slowed = response(0.0, FAR, 360.0), response(slowness, FAR, 360.0)
    assert slowed.max() <= FAR + 0.02 * (FAR - REST)
    near = 0.05 * (FAR - REST)
    arrival, earliest = (int(np.argmax(y > FAR - near)) for y in (slowed, asked))
    assert arrival <= 1.1 * earliest


@pytest.mark.parametrize("slowness", [0.0, 1.0, 2.0])
def test_the_course_after_a_limit_is_the_one_that_asks_for_no_more(slowness: float) -> None:
    state = designed(slowness)
    asked = filter_reference(state, FAR)
    course = list(state.course)
    condition_reference(state, -40.0, 0.0)
    assert state.course == course
    condition_reference(state, -40.0, 5e3)
    assert np.dot(state.loop, state.course) / sum(state.loop) == pytest.approx(asked - 40.0 / 5e3)


def test_a_filter_that_has_its_design_before_its_first_reference_begins_there() -> None:
    """Gains that were trusted last act from the first slow period on: the course starts at rest."""
    state = new_reference_filter(2, 5)
    state.asked[:], state.loop[:] = [1.0, -0.9, 0.2, 0.0, 0.0], [1.0, -1.0, 0.3, *[0.0] * 5]
    assert filter_reference(state, 3.0) == 3.0
    assert filter_reference(state, 3.0) == pytest.approx(3.0)


def test_a_reference_that_is_not_a_number_leaves_no_trace() -> None:
    state = designed(1.0)
    assert math.isnan(filter_reference(state, math.nan))
    assert filter_reference(state, REST) == pytest.approx(REST)
    assert filter_reference(state, 3.2) == pytest.approx(filter_reference(designed(1.0), 3.2))
