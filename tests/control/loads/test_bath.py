"""The bath's model against its differential equation and the published maps."""

import math

import numpy as np
import pytest

from adaptdrive.control.design import discrete_model
from adaptdrive.control.load import to_input, to_voltage
from adaptdrive.control.loads.bath import bath_load, paper_model, physical
from adaptdrive.control.supervisor import Verdict, judge_load
from tests.closed_loop.bench import PAPER
from tests.control.systems import System, held_polynomials

BATH = bath_load(0.02104, 200.0, turns_ratio=0.25, droop_Ohm=1.0, heater_Ohm=7.87)


def test_the_published_maps_between_voltage_and_power() -> None:
    power = to_input(400.0, BATH.input_gain, BATH.input_exponent)
    current = 0.25 * 400.0 / (1.0 + 7.87)
    assert power == pytest.approx(current**2 * 7.87)
    assert power == pytest.approx(1000.0, rel=0.005)
    by_formula = (1.0 + 7.87) / 0.25 * math.sqrt(500.0 / 7.87)
    assert to_voltage(500.0, BATH.input_gain, BATH.input_exponent) == pytest.approx(by_formula)


def test_the_papers_model_is_the_step_invariant_one() -> None:
    numerator, denominator = list(BATH.numerator), list(BATH.denominator)
    a, b = paper_model(numerator, denominator, 20.0)
    expected_a, expected_b = held_polynomials(System(numerator, denominator), 20.0)
    assert np.allclose([*a, *b], [*expected_a, *expected_b], rtol=1e-12)
    assert physical(numerator, denominator) == pytest.approx([0.02104, 200.0])


@pytest.mark.parametrize("pole", [30.0, 1e3, 1e12])
def test_an_estimate_that_grows_beyond_all_numbers_is_refused(pole: float) -> None:
    """The paper's design has no bounds for what is estimated."""
    a, _ = discrete_model(PAPER, BATH, [0.0, 1e-4], [1.0, -pole], 25.0)
    assert judge_load(a) == Verdict.NOT_FINITE
