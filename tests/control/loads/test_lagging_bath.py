"""A bath whose sensor lags and answers late: the loop of its design against scipy's simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.control.design import discrete_model, past_inputs, reference_lead
from adaptdrive.control.fast_half import filter_sample, new_filter_bank
from adaptdrive.control.loads.bath import bath_load
from tests.closed_loop.bench import EXACT, TICK_s
from tests.control.systems import System

LAGGING = bath_load(0.021, 140.0, 0.25, 1.0, 7.87, lag_s=20.0, delay_s=18.0)


def test_its_parameters_are_a_resistance_and_sum_and_product_of_its_lags() -> None:
    numerator, denominator = LAGGING.numerator, LAGGING.denominator
    assert LAGGING.names == ("resistance_K_per_W", "tau_sum_s", "tau_product_s2")
    found = LAGGING.physical(list(numerator), list(denominator))
    assert found == pytest.approx([0.021, 160.0, 2800.0])
    plain = bath_load(0.021, 140.0, 0.25, 1.0, 7.87)
    assert LAGGING.input_gain == plain.input_gain
    assert LAGGING.input_exponent == 2
    assert plain.order == 1


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
    rest = prompt.load_input
    inputs = rest + np.random.default_rng(3).normal(size=400)
    for n in range(400):
        filter_sample(late, 5.0, float(inputs[n]), stride)
        early = n - ticks // stride
        filter_sample(prompt, 5.0, float(inputs[early]) if early >= 0 else rest, stride)
    assert late.inputs == pytest.approx(prompt.inputs, rel=1e-12)
    assert late.load_input == pytest.approx(prompt.load_input, rel=1e-12)
