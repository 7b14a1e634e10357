"""The λ chains against scipy's discretisations and exact series."""

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from adaptdrive.control.lambda_filter import advance, chain_decay, ramp_gains, step_gains
from tests.control.systems import Array

TICK_s = 1.0 / 120.0
ORDERS = [1, 2, 3, 4, 5]
RATIOS = [1e-4, TICK_s / 10.0, 0.02, 0.3, 2.0]


def cascade(order: int) -> tuple[Array, Array, Array, Array]:
    """Equal first-order filters in a row, of unit time constant; every stage is an output."""
    a = np.diag(-np.ones(order)) + np.diag(np.ones(order - 1), -1)
    b = np.eye(order)[:, :1]
    return a, b, np.eye(order), np.zeros((order, 1))


def gains_of(order: int, h: float) -> tuple[list[float], list[float], list[float]]:
    return chain_decay(order, h, 1.0), step_gains(order, h, 1.0), ramp_gains(order, h, 1.0)


def toeplitz(decay: list[float]) -> Array:
    size = len(decay)
    return np.array([[decay[i - j] if i >= j else 0.0 for j in range(size)] for i in range(size)])


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("h", RATIOS)
def test_the_held_chain_is_the_step_invariant_discretisation(order: int, h: float) -> None:
    a, b, *_ = cont2discrete(cascade(order), h, "zoh")
    assert np.abs(toeplitz(chain_decay(order, h, 1.0)) - a).max() < 1e-12
    assert np.abs(np.array(step_gains(order, h, 1.0)) - b[:, 0]).max() < 1e-12


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("h", RATIOS)
def test_the_ramp_chain_is_the_first_order_hold_discretisation(order: int, h: float) -> None:
    a, b, _, d, _ = cont2discrete(cascade(order), h, "foh")
    held, ramp = np.array(step_gains(order, h, 1.0)), np.array(ramp_gains(order, h, 1.0))
    assert np.abs(ramp - d[:, 0]).max() < 1e-12
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


@pytest.mark.parametrize(
    "h", [Fraction(1, 100_000), Fraction(1, 1200), Fraction(1, 10), Fraction(2)]
)
def test_the_gains_keep_full_precision_at_high_order_and_short_ticks(h: Fraction) -> None:
    held, ramp = step_gains(5, float(h), 1.0), ramp_gains(5, float(h), 1.0)
    for stage in range(1, 6):
        assert held[stage - 1] == pytest.approx(series(stage, h, ramp=False), rel=1e-13)
        assert ramp[stage - 1] == pytest.approx(series(stage, h, ramp=True), rel=1e-13)


@given(
    st.integers(1, 5),
    st.floats(0.001, 1.0),
    st.lists(st.floats(-5.0, 5.0), min_size=2, max_size=30),
)
def test_a_chain_follows_a_broken_line_exactly(order: int, h: float, corners: list[float]) -> None:
    chain = [corners[0]] * order
    gains = gains_of(order, h)
    a, b, _, d, _ = cont2discrete(cascade(order), h, "foh")
    shifted = np.full(order, corners[0]) - d[:, 0] * corners[0]
    for start, end in pairwise(corners):
        advance(chain, *gains, start, end)
        shifted = a @ shifted + b[:, 0] * start
        assert np.allclose(chain, shifted + d[:, 0] * end, rtol=0.0, atol=1e-11)
