"""Gains against what the estimate may be wrong by: polynomial algebra checked with numpy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from adaptdrive.control.design import compensator_gains, discrete_model
from adaptdrive.control.load import Load
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.robustness import closes_stably, stands_uncertainty
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.slow_half import slow_step
from adaptdrive.control.slow_state import SlowState, new_slow_state
from adaptdrive.control.supervisor import Verdict
from tests.closed_loop.bench import AT_REST, EXACT, MOTOR, REST_V
from tests.control.systems import decades

BOLD = replace(EXACT, jacket=replace(EXACT.jacket, confidence=2.0))
LOADS = {
    "motor": MOTOR,
    "bath": bath_load(0.021, 200.0, 0.25, 1.0, 7.87),
    "battery": battery_load(0.25, 0.3, 0.05, 60.0),
}


def motor_gains(tau_motor_s: float, pole: float = 0.7) -> list[float]:
    a, b = motor_model(tau_motor_s)
    return compensator_gains(a, b, 2, pole)


def motor_model(tau_motor_s: float) -> tuple[list[float], list[float]]:
    values = [0.011, tau_motor_s + 10.0, tau_motor_s * 10.0]
    return discrete_model(BOLD, MOTOR, *MOTOR.realise(values), 1.0)


@pytest.mark.parametrize("load", LOADS.values(), ids=LOADS.keys())
def test_a_load_is_made_of_its_physical_parameters(load: Load) -> None:
    values = load.physical(list(load.numerator), list(load.denominator))
    numerator, denominator = load.realise(values)
    assert numerator == pytest.approx(load.numerator, rel=1e-14)
    assert denominator == pytest.approx(load.denominator, rel=1e-14)


@pytest.mark.parametrize("load", LOADS.values(), ids=LOADS.keys())
@given(shares=st.lists(decades(0.2, 8.0), min_size=3, max_size=3))
def test_parameters_and_models_are_inverse_to_each_other(load: Load, shares: list[float]) -> None:
    nominal = load.physical(list(load.numerator), list(load.denominator))
    values = [n * share for n, share in zip(nominal, shares, strict=False)]
    assert load.physical(*load.realise(values)) == pytest.approx(values, rel=1e-12)


@given(decades(2.0, 120.0), decades(2.0, 120.0), st.floats(0.5, 0.95))
def test_stability_is_that_of_the_roots(designed_s: float, true_s: float, pole: float) -> None:
    gains, (a, b) = motor_gains(designed_s, pole), motor_model(true_s)
    taps = len(gains) - 3
    forward, back = np.convolve(a, [1.0, *gains[:taps]]), np.convolve(b, gains[taps:])
    length = max(len(forward), len(back))
    closed = np.pad(forward, (0, length - len(forward))) + np.pad(back, (0, length - len(back)))
    radius = np.abs(np.roots(closed)).max()
    for margin in (0.99, 1.01):
        assert closes_stably(gains, a, b, 2, radius / margin) == (margin < 1.0)


def test_gains_for_a_sure_estimate_stand() -> None:
    values = [0.011, 33.4, 234.0]
    deviations = [0.02 * value for value in values]
    assert stands_uncertainty(BOLD, MOTOR, motor_gains(23.4), values, deviations, 1.0)


def test_gains_that_a_likely_load_would_make_unstable_do_not() -> None:
    values, gains = [0.011, 33.4, 234.0], motor_gains(23.4, 0.4)
    assert stands_uncertainty(BOLD, MOTOR, gains, values, [0.0, 0.0, 0.0], 1.0)
    assert not stands_uncertainty(BOLD, MOTOR, gains, values, [0.0, 0.0, 80.0], 1.0)
    off = replace(BOLD, jacket=replace(BOLD.jacket, confidence=0.0))
    assert stands_uncertainty(off, MOTOR, gains, values, [0.0, 0.0, 80.0], 1.0)
    shaky = motor_gains(300.0, 0.3)
    assert radius(shaky, values) > 1.0
    assert stands_uncertainty(off, MOTOR, shaky, values, [9.0, 9.0, 80.0], 1.0)


def radius(gains: list[float], values: list[float]) -> float:
    """Largest pole of the loop of some gains with a motor, by numpy."""
    a, b = discrete_model(BOLD, MOTOR, *MOTOR.realise(values), 1.0)
    forward, back = np.convolve(a, [1.0, *gains[: len(b) - 1]]), np.convolve(b, gains[len(b) - 1 :])
    length = max(len(forward), len(back))
    padded = [np.pad(one, (0, length - len(one))) for one in (forward, back)]
    return float(np.abs(np.roots(padded[0] + padded[1])).max())


@given(
    st.lists(decades(0.004, 0.9), min_size=3, max_size=3),
    st.floats(0.3, 0.9),
    st.sampled_from([1.0, 2.0, 3.0]),
)
def test_each_parameter_that_is_not_sure_is_tried_up_and_down(
    shares: list[float], pole: float, confidence: float
) -> None:
    values, gains = [0.011, 33.4, 234.0], motor_gains(23.4, pole)
    radii = []
    for index, share in enumerate(shares):
        for moved in (share, -share) if share > 0.03 else ():
            vertex = list(values)
            vertex[index] *= max(1.0 + confidence * moved, 0.05)
            radii.append(radius(gains, vertex))
    worst = max(radii, default=0.0)
    assume(abs(worst - 0.995) > 1e-6)
    settings = replace(BOLD, jacket=replace(BOLD.jacket, confidence=confidence))
    deviations = [value * share for value, share in zip(values, shares, strict=True)]
    found = stands_uncertainty(settings, MOTOR, gains, values, deviations, 1.0)
    assert found is (worst < 0.995)


@pytest.mark.parametrize(("share", "stands"), [(0.0299, True), (0.0301, False)])
def test_what_is_known_to_three_percent_is_not_tried(share: float, stands: bool) -> None:
    values, wary = [0.011, 33.4, 234.0], replace(BOLD.jacket, confidence=25.0)
    deviations, settings = [0.0, 0.0, share * 234.0], replace(BOLD, jacket=wary)
    found = stands_uncertainty(settings, MOTOR, motor_gains(23.4, 0.4), values, deviations, 1.0)
    assert found is stands


def test_what_is_unknown_is_not_tried() -> None:
    values = [0.011, 33.4, 234.0]
    assert stands_uncertainty(BOLD, MOTOR, motor_gains(23.4), values, [math.nan] * 3, 1.0)


@pytest.mark.parametrize("deviation", [0.0, 1.0, math.nan])
def test_a_parameter_of_0_is_not_tried(deviation: float) -> None:
    """A battery that is learnt without filters has a model without a direct term."""
    battery, values = LOADS["battery"], [0.0, 0.2, 15.0]
    a, b = discrete_model(BOLD, battery, *battery.realise(values), 1.0)
    gains = compensator_gains(a, b, battery.order, 0.7)
    assert stands_uncertainty(BOLD, battery, gains, values, [deviation, math.nan, 0.0], 1.0)


def judged(settings: ControllerSettings, trusted_s: float, alarms: int = 0) -> int:
    """The verdict on a sound nominal estimate beside a trusted model that lies elsewhere."""
    jacket = replace(settings.jacket, warm_up_periods=0)
    settings = replace(settings, jacket=jacket)
    state = new_slow_state(settings, MOTOR, 3.0, REST_V)
    state.supervisor.trusted = True
    state.trusted_a, state.trusted_b = motor_model(trusted_s)
    state.estimator.surprise.alarms = alarms
    step(settings, state)
    return state.supervisor.verdict


def step(settings: ControllerSettings, state: SlowState) -> None:
    slow_step(settings, MOTOR, state, AT_REST)


def test_gains_that_the_last_trusted_load_would_not_stand_are_refused() -> None:
    assert judged(BOLD, 11.7) == Verdict.TRUSTED
    assert judged(BOLD, 0.5) == Verdict.AT_ODDS
    assert judged(EXACT, 0.5) == Verdict.TRUSTED


def test_an_abrupt_change_makes_the_last_trusted_load_history() -> None:
    assert judged(BOLD, 0.5, alarms=1) == Verdict.TRUSTED
