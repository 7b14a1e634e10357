"""Each kind of load against the plain physics of its circuit or its heat, with drawn parameters."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.load import Load
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.motor import motor_load
from tests.control.systems import System

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
    _, b = load.paper_model(list(load.numerator), list(load.denominator), 1.0)
    assert len(b) == load.paper_taps + 1


@given(gain=SIZES, motor_s=SIZES, filter_s=SIZES)
def test_a_motor_is_two_lags_behind_a_voltage(gain: float, motor_s: float, filter_s: float) -> None:
    load = motor_load(gain, motor_s, filter_s)
    responds(load, lambda s: gain / ((motor_s * s + 1.0) * (filter_s * s + 1.0)))
    values = load.physical(list(load.numerator), list(load.denominator))
    assert values == pytest.approx([gain, motor_s + filter_s, motor_s * filter_s])
    assert load.names == ("gain", "tau_sum_s", "tau_product_s2")
    assert (load.input_gain, load.input_exponent) == (1.0, 1)
    assert load.charging is None


@given(resistance=SIZES, tau_s=SIZES, ratio=SIZES, droop=SIZES, heater=SIZES)
def test_a_bath_is_one_lag_behind_the_power_of_its_heater(
    resistance: float, tau_s: float, ratio: float, droop: float, heater: float
) -> None:
    load = bath_load(resistance, tau_s, ratio, droop, heater)
    responds(load, lambda s: resistance / (tau_s * s + 1.0))
    current = 7.0 * ratio / (droop + heater)
    assert load.input_gain * 7.0**load.input_exponent == pytest.approx(current**2 * heater)
    values = load.physical(list(load.numerator), list(load.denominator))
    assert values == pytest.approx([resistance, tau_s])
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
