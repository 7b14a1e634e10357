"""Loads against the physics of their circuits, scipy's discretisation and the published maps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.design.pole_placement import discrete_model, past_inputs, reference_lead
from adaptdrive.control.fast import filter_sample, new_filter_bank
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.bath import paper_model as bath_model
from adaptdrive.control.loads.bath import physical as bath_values
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.battery import paper_model as battery_model
from adaptdrive.control.loads.load import Load, to_input, to_voltage
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.loads.motor import paper_model as motor_model
from adaptdrive.control.supervision.supervisor import Verdict, judge_poles
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from tests.integration.closed_loop.bench import EXACT, PAPER, TICK_s
from tests.unit.control.systems import System, held_polynomials, impulse_invariant

SIZES = st.floats(min_value=0.1, max_value=10.0)
FREQUENCIES_rad_s = (0.0, 0.05, 0.5, 20.0)


def responds(load: Load, expected: Callable[[complex], complex]) -> None:
    """Hold a load against its transfer function, and its parameters against the way back."""
    system = System(list(load.numerator), list(load.denominator))
    for rad_s in FREQUENCIES_rad_s:
        assert system.response(rad_s) == pytest.approx(expected(1j * rad_s), rel=1e-9)
    values = load.physical(list(load.numerator), list(load.denominator))
    numerator, denominator = load.realise(values)
    assert numerator == pytest.approx(list(load.numerator))
    assert denominator == pytest.approx(list(load.denominator))
    assert len(values) == len(load.names) == len(set(load.names))
    powers = [i for i, b in enumerate(load.numerator) if b != 0.0]
    assert list(load.input_powers) == powers


@given(gain=SIZES, motor_s=SIZES, filter_s=SIZES)
def test_a_motor_is_two_lags_behind_a_voltage(gain: float, motor_s: float, filter_s: float) -> None:
    load = motor_load(gain, motor_s, filter_s)
    responds(load, lambda s: gain / ((motor_s * s + 1.0) * (filter_s * s + 1.0)))
    values = load.physical(list(load.numerator), list(load.denominator))
    assert values == pytest.approx([gain, motor_s + filter_s, motor_s * filter_s])
    assert load.names == ("gain", "tau_sum_s", "tau_product_s2")
    assert (load.input_gain, load.input_exponent) == (1.0, 1)


@given(resistance=SIZES, tau_s=SIZES, ratio=SIZES, droop=SIZES, heater=SIZES)
def test_a_bath_is_one_lag_behind_the_power_of_its_heater(
    resistance: float, tau_s: float, ratio: float, droop: float, heater: float
) -> None:
    load = bath_load(resistance, tau_s, ratio, droop, heater)
    responds(load, lambda s: resistance / (tau_s * s + 1.0))
    current = 7.0 * ratio / (droop + heater)
    assert load.input_gain * 7.0**load.input_exponent == pytest.approx(current**2 * heater)
    lagging = bath_load(resistance, tau_s, ratio, droop, heater, lag_s=20.0)
    found = lagging.physical(list(lagging.numerator), list(lagging.denominator))
    assert found == pytest.approx([resistance, tau_s + 20.0, tau_s * 20.0])
    assert load.names == ("resistance_K_per_W", "tau_s")
    assert load.charging is None


@given(ratio=SIZES, series=SIZES, relaxation=SIZES, tau_s=SIZES)
def test_a_battery_is_a_resistance_and_a_relaxation_element(
    ratio: float, series: float, relaxation: float, tau_s: float
) -> None:
    load = battery_load(ratio, series, relaxation, tau_s)
    responds(load, lambda s: ratio / (series + relaxation / (tau_s * s + 1.0)))
    assert (load.input_gain, load.input_exponent) == (1.0, 1)
    assert load.names == ("direct_S", "gain_S", "tau_s")
    values = load.physical(list(load.numerator), list(load.denominator))
    circuit = [
        ratio / series,
        ratio / (series + relaxation),
        tau_s * series / (series + relaxation),
    ]
    assert values == pytest.approx(circuit)


HEATED = bath_load(0.02104, 200.0, turns_ratio=0.25, droop_Ohm=1.0, heater_Ohm=7.87)


def test_the_published_maps_between_voltage_and_power() -> None:
    power = to_input(400.0, HEATED.input_gain, HEATED.input_exponent)
    current = 0.25 * 400.0 / (1.0 + 7.87)
    assert power == pytest.approx(current**2 * 7.87)
    assert power == pytest.approx(1000.0, rel=0.005)
    by_formula = (1.0 + 7.87) / 0.25 * math.sqrt(500.0 / 7.87)
    assert to_voltage(500.0, HEATED.input_gain, HEATED.input_exponent) == pytest.approx(by_formula)


def test_the_papers_model_is_the_step_invariant_one() -> None:
    numerator, denominator = list(HEATED.numerator), list(HEATED.denominator)
    a, b = bath_model(numerator, denominator, 20.0)
    expected_a, expected_b = held_polynomials(System(numerator, denominator), 20.0)
    assert np.allclose([*a, *b], [*expected_a, *expected_b], rtol=1e-12)
    assert bath_values(numerator, denominator) == pytest.approx([0.02104, 200.0])


@pytest.mark.parametrize("pole", [30.0, 1e3, 1e12])
def test_an_estimate_that_grows_beyond_all_numbers_is_refused(pole: float) -> None:
    """The paper's design has no bounds for what is estimated."""
    a, _ = discrete_model(PAPER, HEATED, [0.0, 1e-4], [1.0, -pole], 25.0)
    assert judge_poles(a, Verdict.UNSTABLE_LOAD) == Verdict.NOT_FINITE


BATTERY = battery_load(turns_ratio=0.25, series_Ohm=1.2, relaxation_Ohm=0.3, relaxation_s=60.0)
SYSTEM = System(list(BATTERY.numerator), list(BATTERY.denominator))


def test_the_discrete_model_is_the_held_one_a_period_later() -> None:
    a, b = battery_model(SYSTEM.numerator, SYSTEM.denominator, 1.0)
    expected_a, expected_b = held_polynomials(SYSTEM, 1.0)
    assert np.allclose(a, expected_a, rtol=1e-12)
    assert np.allclose(b, [0.0, *expected_b], rtol=0.0, atol=1e-12)
    assert len(b) - 1 == past_inputs(PAPER, BATTERY) == 2


@pytest.mark.parametrize("disks", [1, 2, 3])
def test_the_model_is_that_of_the_simulated_motor(disks: int) -> None:
    truth = Motor(MotorParameters(), disks).model(0.25, 1.0)
    expected_model = {"gain": 0.011, "tau_motor_s": 11.7 * disks, "tau_filter_s": 10.0}
    assert {name: truth[name] for name in expected_model} == pytest.approx(expected_model, rel=1e-4)


def test_a_complex_pair_is_a_legal_motor() -> None:
    a, b = motor_model([0.0, 0.0, 1e-4], [1.0, 0.15, 0.01], 1.0)
    assert [*a, *b] == pytest.approx(impulse_invariant(1e-4 / 0.01, 15.0, 100.0, 1.0), rel=1e-12)


LAGGING = bath_load(0.021, 140.0, 0.25, 1.0, 7.87, lag_s=20.0, delay_s=18.0)


def test_the_design_has_the_dead_time_in_its_model() -> None:
    rates = replace(EXACT.rates, ticks_per_period=1200, samples=1, lag_ticks=0.0, latency_ticks=2)
    settings, model = replace(EXACT, rates=rates), LAGGING
    period_s = 1200 * TICK_s
    system = System(list(model.numerator), list(model.denominator))
    a, b = discrete_model(settings, model, system.numerator, system.denominator, period_s)
    assert len(b) - 1 == past_inputs(settings, model) == 4
    assert reference_lead(settings, model) == pytest.approx((18.0 + 2 * TICK_s) / period_s)
    response, past = [], np.zeros(len(a) - 1)
    for k in range(60):
        value = sum(b[1 : k + 1]) - float(np.dot(a[1:], past))
        past = np.concatenate(([value], past[:-1]))
        response.append(value)
    times_s = period_s * np.arange(60)
    late_s = np.maximum(0.0, times_s - 18.0 - 2 * TICK_s)
    slow, fast = np.exp(-late_s / 140.0), np.exp(-late_s / 20.0)
    exact = 0.021 * (1.0 - (140.0 * slow - 20.0 * fast) / 120.0)
    assert response == pytest.approx(exact.tolist(), abs=1e-6)


@pytest.mark.parametrize("stride", [1, 7])
def test_the_filters_see_the_input_of_a_dead_time_ago(stride: int) -> None:
    """As filters without a dead time see an input that was shifted by whole ticks."""
    ticks = 84
    late = new_filter_bank(replace(LAGGING, delay_s=ticks * TICK_s), TICK_s, 80.0, 5.0, 300.0)
    prompt = new_filter_bank(replace(LAGGING, delay_s=0.0), TICK_s, 80.0, 5.0, 300.0)
    rest = prompt.inputs[0]
    inputs = rest + np.random.default_rng(3).normal(size=400)
    for n in range(400):
        filter_sample(late, 5.0, float(inputs[n]), stride)
        early = n - ticks // stride
        filter_sample(prompt, 5.0, float(inputs[early]) if early >= 0 else rest, stride)
    assert late.inputs == pytest.approx(prompt.inputs, rel=1e-12)


@given(st.floats(0.0, 500.0), st.floats(1e-4, 10.0), st.sampled_from([1, 2]))
def test_there_and_back(voltage: float, gain: float, exponent: int) -> None:
    back = to_voltage(to_input(voltage, gain, exponent), gain, exponent)
    assert back == pytest.approx(voltage, rel=1e-9, abs=1e-150)


def test_a_square_law_has_no_voltage_for_a_negative_input() -> None:
    assert to_voltage(-1.0, 0.5, 2) == 0.0
    assert to_input(200.0, 0.00625, 2) == 250.0
