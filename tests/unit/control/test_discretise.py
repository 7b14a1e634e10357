"""Discrete models against scipy, exact simulation and residues, and the way back."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.signal import cont2discrete, dlsim, lfilter

from adaptdrive.control.estimation.direct import continuous_model
from adaptdrive.control.loads.discretise import (
    held_model,
    propagated,
)
from adaptdrive.control.loads.motor import paper_model, realise
from adaptdrive.control.vectors import Vector
from tests.unit.control.systems import (
    Array,
    System,
    decades,
    held_polynomials,
    impulse_invariant,
    polynomials,
    stable_systems,
)

TICKS = 120
"""Sum and product of two time constants of 10 s."""


@given(stable_systems(direct=True), st.sampled_from([0.2, 1.0, 5.0]))
def test_without_delay_it_is_the_step_invariant_discretisation(
    system: System, period_s: float
) -> None:
    a, b = held_model(system.numerator, system.denominator, period_s, 0.0, 0.0)
    bottom, top = held_polynomials(system, period_s)
    assert np.allclose(a, bottom, rtol=0.0, atol=1e-9)
    assert np.allclose(b, top, rtol=0.0, atol=1e-9)


def simulate_finely(system: System, inputs: Array, delay_ticks: int, window_ticks: int) -> Array:
    """Output at the slow instants of a held, delayed input, exactly, on a quantiser of fast ticks.

    An integrator behind the output gives the mean over the window.
    """
    a, b, c, d = system.state_space()
    size = system.order
    with_integral = (
        np.block([[a, np.zeros((size, 1))], [c, np.zeros((1, 1))]]),
        np.vstack([b, d]),
        np.block([[c, np.zeros((1, 1))], [np.zeros((1, size)), np.ones((1, 1))]]),
        np.vstack([d, [[0.0]]]),
    )
    *fast, _ = cont2discrete(with_integral, 1.0 / TICKS, "zoh")
    held = np.concatenate([np.zeros(delay_ticks), np.repeat(inputs, TICKS)])
    _, outputs, *_ = dlsim((*fast, 1.0 / TICKS), held)
    if window_ticks == 0:
        return np.asarray(outputs[: len(inputs) * TICKS : TICKS, 0])
    integral = np.concatenate([np.zeros(window_ticks), outputs[:, 1]])
    means = (integral[window_ticks:] - integral[:-window_ticks]) * TICKS / window_ticks
    return np.asarray(means[: len(inputs) * TICKS : TICKS])


DELAYS = st.integers(0, 3 * TICKS)
WINDOWS = st.sampled_from([0, 1, 30, 60, TICKS, 2 * TICKS])


@given(stable_systems(direct=True), DELAYS, WINDOWS, st.integers(0, 2**32 - 1))
def test_with_delay_and_averaging_it_is_the_simulated_response(
    system: System, delay_ticks: int, window_ticks: int, seed: int
) -> None:
    inputs = np.random.default_rng(seed).normal(size=12)
    delay_s, window_s = delay_ticks / TICKS, window_ticks / TICKS
    a, b = held_model(system.numerator, system.denominator, 1.0, delay_s, window_s)
    expected = simulate_finely(system, inputs, delay_ticks, window_ticks)
    assert np.allclose(lfilter(b, a, inputs), expected, rtol=0.0, atol=1e-8)
    assert len(b) == 1 + system.order + math.ceil((delay_ticks + window_ticks) / TICKS)


@given(stable_systems(direct=True), st.floats(0.0, 40.0))
def test_what_is_propagated_is_multiplied_by_the_matrix_exponential(
    system: System, duration_s: float
) -> None:
    order = system.order
    a, b, c, d = (np.flip(block) for block in system.state_space())
    whole = np.block(
        [
            [a, b, np.zeros((order, 1))],
            [np.zeros((1, order + 2))],
            [c, d, np.zeros((1, 1))],
        ]
    )
    state = np.arange(1.0, order + 3.0)
    expected = expm(whole * duration_s) @ state
    moved = propagated([*a[-1], *c[0], float(d[0, 0])], state.tolist(), duration_s)
    assert np.allclose(moved, expected, rtol=1e-9, atol=1e-9 * np.abs(state).max())


def sampled_impulse(gain: float, tau_sum: float, tau_product: float, period_s: float) -> Array:
    """A and B by scipy."""
    system = System([0.0, 0.0, gain / tau_product], [1.0, tau_sum / tau_product, 1.0 / tau_product])
    return np.concatenate(polynomials(cont2discrete(system.state_space(), period_s, "impulse")))


@given(st.floats(0.001, 10.0), st.floats(0.0, 1.9), decades(1.0, 40.0), st.floats(0.1, 5.0))
def test_the_papers_model_of_a_motor_is_the_impulse_invariant_one_whatever_the_poles(
    gain: float, damping: float, tau_s: float, period_s: float
) -> None:
    tau_sum, tau_product = max(0.1, 2.0 * damping) * tau_s, tau_s**2
    a, b = paper_model(*realise([gain, tau_sum, tau_product]), period_s)
    for model in (sampled_impulse, impulse_invariant):
        expected = model(gain, tau_sum, tau_product, period_s)
        assert np.allclose([*a, *b], expected, rtol=0.0, atol=1e-11 * max(1.0, gain))


@given(
    st.tuples(*[st.floats(-1e300, 1e300)] * 3),
    st.tuples(*[st.floats() | st.floats(-1e3, 1e3)] * 2),
    st.sampled_from([0.01, 1.0, 30.0]),
)
def test_an_absurd_load_has_a_model_of_no_finite_numbers_and_no_error(
    numerator: tuple[float, ...], rest: tuple[float, ...], period_s: float
) -> None:
    a, b = held_model(list(numerator), [1.0, *rest], period_s, 0.1 * period_s, 0.5 * period_s)
    assert (len(a), len(b)) == (3, 4)
    if not np.isfinite(rest).all():
        assert not np.isfinite(a).all()


@pytest.mark.parametrize(
    "a",
    [[1.0, 0.5], [1.0, 0.0], [1.0, 0.2, -0.5], [1.0, 0.9, 0.2], [1.0, 0.0, 0.0], [1.0, 0, 0, 0.1]],
)
def test_where_there_is_no_such_load_the_answer_is_not_a_number(a: Vector) -> None:
    numerator, denominator = continuous_model(a, [0.0, 1.0], 1.0)
    assert math.isnan(denominator[-1])
    assert math.isnan(numerator[-1])


@given(stable_systems((1, 2)), st.floats(0.1, 1.0))
def test_it_undoes_the_discretisation_of_scipy(system: System, period_s: float) -> None:
    plain = System([0.0] * system.order + system.numerator[-1:], system.denominator)
    a, b = held_polynomials(plain, period_s)
    numerator, denominator = continuous_model(a.tolist(), b.tolist(), period_s)
    assert denominator == pytest.approx(system.denominator, rel=1e-6)
    assert numerator == pytest.approx(plain.numerator, rel=1e-6)
