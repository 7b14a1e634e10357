"""λ chains against scipy and exact series, its transform against definition and closed form."""

import cmath
import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from adaptdrive.control.estimation.filters import advance, chain_gains
from adaptdrive.control.estimation.regression import from_lambda, to_lambda
from tests.unit.control.systems import Array, System, decades, motor_system, stable_systems

TICK_s = 1.0 / 120.0
ORDERS = [1, 2, 3, 4, 5]
RATIOS = [1e-4, TICK_s / 10.0, 0.02, 0.3, 2.0]


def cascade(order: int) -> tuple[Array, Array, Array, Array]:
    """Equal first-order filters in a row, of unit time constant; every stage is an output."""
    a = np.diag(-np.ones(order)) + np.diag(np.ones(order - 1), -1)
    b = np.eye(order)[:, :1]
    return a, b, np.eye(order), np.zeros((order, 1))


def toeplitz(decay: list[float]) -> Array:
    size = len(decay)
    return np.array([[decay[i - j] if i >= j else 0.0 for j in range(size)] for i in range(size)])


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("h", RATIOS)
def test_the_held_chain_is_the_step_invariant_discretisation(order: int, h: float) -> None:
    a, b, *_ = cont2discrete(cascade(order), h, "zoh")
    decay, held, _ = chain_gains(order, h, 1.0)
    assert np.abs(toeplitz(decay) - a).max() < 1e-12
    assert np.abs(np.array(held) - b[:, 0]).max() < 1e-12


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("h", RATIOS)
def test_the_ramp_chain_is_the_first_order_hold_discretisation(order: int, h: float) -> None:
    a, b, _, d, _ = cont2discrete(cascade(order), h, "foh")
    gains = np.array(chain_gains(order, h, 1.0))
    _, held, ramp = gains
    assert np.abs(ramp - d[:, 0]).max() < 1e-12
    # only the ratio of the times counts
    assert np.array(chain_gains(order, 7.0 * h, 7.0)) == pytest.approx(gains, rel=1e-13)
    # scipy shifts the state by the ramp response to make the system a proper one
    assert np.abs((held - ramp) + (a - np.eye(order)) @ ramp + ramp - b[:, 0]).max() < 1e-12


def series(stage: int, h: Fraction, ramp: bool) -> float:
    """Response of λ^i to a held or rising input: the incomplete gamma function, exactly.

    P(i, h) = h^i/(i-1)! Σ_k (-h)^k / (k! (i+k)); the ramp response is its mean over 0...h.
    """
    terms = Fraction(0)
    for k in range(40):
        share = 1 if not ramp else Fraction(1, stage + k + 1)
        terms += (-h) ** k / (math.factorial(k) * (stage + k)) * share
    return float(h**stage / math.factorial(stage - 1) * terms)


@given(
    st.integers(1, 5),
    st.floats(0.001, 1.0),
    st.lists(st.floats(-5.0, 5.0), min_size=2, max_size=30),
)
def test_a_chain_follows_a_broken_line_exactly(order: int, h: float, corners: list[float]) -> None:
    chain = [corners[0]] * (order + 1)
    gains = chain_gains(order, h, 1.0)
    a, b, _, d, _ = cont2discrete(cascade(order), h, "foh")
    shifted = np.full(order, corners[0]) - d[:, 0] * corners[0]
    for start, end in pairwise(corners):
        advance(chain, gains, end)
        shifted = a @ shifted + b[:, 0] * start
        assert np.allclose(chain[1:], shifted + d[:, 0] * end, rtol=0.0, atol=1e-11)


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
