"""The λ transform against the definition of λ, the motor's closed form, and itself."""

import cmath
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.lambda_transform import binomial, from_lambda, to_lambda
from tests.control.systems import System, decades, motor_system, stable_systems

SYSTEMS = stable_systems((1, 5), direct=True)
TAUS = decades(1.0, 30.0)


@given(SYSTEMS, TAUS)
def test_there_and_back_gives_the_same_polynomials(system: System, tau_s: float) -> None:
    for polynomial in (system.numerator, system.denominator):
        transformed = to_lambda(polynomial, tau_s)
        rounding = from_lambda([abs(x) for x in transformed], tau_s)
        for back, given_, scale in zip(
            from_lambda(transformed, tau_s), polynomial, rounding, strict=True
        ):
            assert abs(back - given_) <= 1e-13 * scale + 1e-300


@given(SYSTEMS, TAUS, decades(1e-3, 10.0))
def test_the_frequency_response_is_the_ratio_of_the_polynomials_in_lambda(
    system: System, tau_s: float, rad_s: float
) -> None:
    lowpass = 1.0 / (1.0 + 1j * rad_s * tau_s)
    alpha, beta = to_lambda(system.denominator, tau_s), to_lambda(system.numerator, tau_s)
    bottom = sum(c * lowpass**i for i, c in enumerate(alpha))
    top = sum(c * lowpass**i for i, c in enumerate(beta))
    rounding = sum(abs(c) * abs(lowpass) ** i for i, c in enumerate(alpha))
    assert alpha[0] == 1.0
    assert abs(top - system.response(rad_s) * bottom) <= 1e-11 * rounding


@pytest.mark.parametrize("tau_s", [3.0, 10.0, 25.0])
@pytest.mark.parametrize("disks", [1, 2, 3])
def test_the_motor_is_recovered_by_the_published_formula(disks: int, tau_s: float) -> None:
    _, alpha1, alpha2 = to_lambda(motor_system(disks).denominator, tau_s)
    _, beta1, beta2 = to_lambda(motor_system(disks).numerator, tau_s)
    gain = beta2 / (alpha1 + alpha2 + 1.0)
    root = cmath.sqrt(alpha1**2 - 4.0 * alpha2)
    taus = [tau_s * gain / (2.0 * beta2) * (2.0 + alpha1 + sign * root) for sign in (1, -1)]
    assert beta1 == 0.0
    assert gain == pytest.approx(0.011, rel=1e-12)
    assert max(taus, key=abs) == pytest.approx(11.7 * disks, rel=1e-6)
    assert min(taus, key=abs) == pytest.approx(10.0, rel=1e-6)


@given(st.floats(-1.9, 1.0), st.floats(0.01, 2.0), st.floats(1e-3, 1.0), decades(1.0, 30.0))
def test_a_complex_pair_has_a_real_sum_and_product(
    alpha1: float, spread: float, beta2: float, tau_s: float
) -> None:
    alpha2 = 0.25 * alpha1**2 + spread
    everything = 1.0 + alpha1 + alpha2
    _, first, second = from_lambda([1.0, alpha1, alpha2], tau_s)
    numerator = from_lambda([0.0, 0.0, beta2], tau_s)
    assert first / second == pytest.approx(tau_s * (2.0 + alpha1) / everything, rel=1e-9)
    assert 1.0 / second == pytest.approx(tau_s**2 / everything, rel=1e-9)
    assert numerator[2] / second == pytest.approx(beta2 / everything, rel=1e-9)


def test_binomial_counts() -> None:
    assert all(binomial(n, k) == math.comb(n, k) for n in range(12) for k in range(n + 4))
