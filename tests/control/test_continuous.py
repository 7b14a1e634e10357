"""From discrete models back to continuous ones: the inverse of the exact discretisation."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.continuous import continuous_model
from adaptdrive.control.discretise import held_model
from adaptdrive.control.vectors import Vector

gains = st.floats(0.01, 100.0)
times = st.floats(2.0, 100.0)


def there_and_back(numerator: Vector, denominator: Vector) -> tuple[Vector, Vector]:
    a, b = held_model(numerator, denominator, 1.0, 0.0, 0.0)
    return continuous_model(a, b, 1.0)


@given(gain=gains, tau_s=times)
def test_a_first_order_load_comes_back(gain: float, tau_s: float) -> None:
    numerator, denominator = there_and_back([0.0, gain / tau_s], [1.0, 1.0 / tau_s])
    assert denominator == pytest.approx([1.0, 1.0 / tau_s], rel=1e-9)
    assert numerator == pytest.approx([0.0, gain / tau_s], rel=1e-8)


@given(gain=gains, radius=st.floats(0.02, 0.5), damping=st.floats(0.1, 3.0))
def test_a_second_order_load_comes_back_whether_its_poles_are_real_or_not(
    gain: float, radius: float, damping: float
) -> None:
    square = radius * radius
    wanted = [1.0, 2.0 * damping * radius, square]
    numerator, denominator = there_and_back([0.0, 0.0, gain * square], wanted)
    assert denominator == pytest.approx(wanted, rel=1e-6)
    assert numerator == pytest.approx([0.0, 0.0, gain * square], rel=1e-6)


@pytest.mark.parametrize(
    "a",
    [[1.0, 0.5], [1.0, 0.0], [1.0, 0.2, -0.5], [1.0, 0.9, 0.2], [1.0, 0.0, 0.0], [1.0, 0, 0, 0.1]],
)
def test_where_there_is_no_such_load_the_answer_is_not_a_number(a: Vector) -> None:
    numerator, denominator = continuous_model(a, [0.0, 1.0], 1.0)
    assert math.isnan(denominator[-1])
    assert math.isnan(numerator[-1])


def test_a_load_without_a_gain_at_rest_has_none_here() -> None:
    numerator, _ = continuous_model([1.0, -1.0], [0.0, 1.0], 1.0)
    assert math.isnan(numerator[1])
