"""The input map."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.load import to_input, to_voltage
from tests.closed_loop.bench import MOTOR


@given(st.floats(0.0, 500.0), st.floats(1e-4, 10.0), st.sampled_from([1, 2]))
def test_there_and_back(voltage: float, gain: float, exponent: int) -> None:
    back = to_voltage(to_input(voltage, gain, exponent), gain, exponent)
    assert back == pytest.approx(voltage, rel=1e-9, abs=1e-150)


def test_a_square_law_has_no_voltage_for_a_negative_input() -> None:
    assert to_voltage(-1.0, 0.5, 2) == 0.0
    assert to_input(200.0, 0.00625, 2) == 250.0


def test_the_order_is_that_of_the_denominator() -> None:
    assert MOTOR.order == 2
