"""From discrete models back to continuous ones: the inverse of the exact discretisation."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.continuous import continuous_model
from adaptdrive.control.vectors import Vector
from tests.control.systems import System, decades, held_polynomials, stable_systems


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


@given(stable_systems((1, 2)), st.floats(0.1, 1.0))
def test_it_undoes_the_discretisation_of_scipy(system: System, period_s: float) -> None:
    plain = System([0.0] * system.order + system.numerator[-1:], system.denominator)
    a, b = held_polynomials(plain, period_s)
    numerator, denominator = continuous_model(a.tolist(), b.tolist(), period_s)
    assert denominator == pytest.approx(system.denominator, rel=1e-6)
    assert numerator == pytest.approx(plain.numerator, rel=1e-6)


@given(decades(0.5, 20.0), decades(1e-3, 100.0))
def test_the_gain_is_that_at_rest_whatever_the_zeros(tau_s: float, gain: float) -> None:
    decay = math.exp(-1.0 / tau_s)
    b = [0.0, 0.7 * gain * (1.0 - decay), 0.3 * gain * (1.0 - decay)]
    numerator, denominator = continuous_model([1.0, -decay], b, 1.0)
    assert numerator[1] / denominator[1] == pytest.approx(gain)


@pytest.mark.parametrize("a", [[1.0, math.nan], [1.0, math.nan, 0.5], [1.0, -math.inf, 0.5]])
def test_what_is_not_a_number_gives_none(a: Vector) -> None:
    numerator, denominator = continuous_model(a, [0.0] + [1.0] * (len(a) - 1), 1.0)
    assert not np.isfinite([*numerator, *denominator]).all()
