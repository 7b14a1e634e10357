"""The supervisor's verdicts, warm-up and patience."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from adaptdrive.control.settings import Jacket
from adaptdrive.control.supervisor import (
    SupervisorState,
    Verdict,
    judge_bounds,
    judge_damping,
    judge_load,
    judge_loop,
    judge_model,
    take_verdict,
)

JACKET = Jacket(warm_up_periods=90, ratio_min=0.2, ratio_max=8.0, patience_periods=3)
DAMPED = replace(JACKET, damping_min=0.8)
NOMINAL = [0.011, 21.7, 117.0]
WRONG = [
    Verdict.NOT_FINITE,
    Verdict.UNSTABLE_LOAD,
    Verdict.OUT_OF_BOUNDS,
    Verdict.UNSTABLE_LOOP,
    Verdict.WORSE_THAN_FIXED,
    Verdict.AT_ODDS,
]


def test_a_finite_model_with_a_dc_gain_is_usable() -> None:
    assert judge_model([0.0, 0.0, 1e-4], [1.0, 0.2, 0.01]) == Verdict.TRUSTED


@pytest.mark.parametrize(
    ("numerator", "denominator"),
    [
        ([0.0, 0.0, math.nan], [1.0, 0.2, 0.01]),
        ([0.0, 0.0, 1e-4], [1.0, math.inf, 0.01]),
        ([0.0, 0.0, 1e-4], [1.0, 0.2, 0.0]),
    ],
)
def test_a_model_that_is_no_number_or_has_no_dc_gain_is_refused(
    numerator: list[float], denominator: list[float]
) -> None:
    assert judge_model(numerator, denominator) == Verdict.NOT_FINITE


@given(st.lists(st.floats(0.2, 8.0), min_size=3, max_size=3))
def test_parameters_within_bounds_are_trusted(ratios: list[float]) -> None:
    values = [n * ratio for n, ratio in zip([1.0, 4.0, -2.0], ratios, strict=True)]
    assert judge_bounds(values, [1.0, 4.0, -2.0], JACKET, SupervisorState()) == Verdict.TRUSTED


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize("ratio", [0.19, 8.1, -1.0, 0.0, math.nan, math.inf])
def test_the_parameter_out_of_bounds_is_named(index: int, ratio: float) -> None:
    values, state = list(NOMINAL), SupervisorState()
    values[index] *= ratio
    assert judge_bounds(values, NOMINAL, JACKET, state) == Verdict.OUT_OF_BOUNDS
    assert state.culprit == index


@given(st.floats(0.01, 1e3), st.floats(0.01, 1e3))
def test_every_load_with_real_time_constants_is_damped_enough(one_s: float, other_s: float) -> None:
    denominator = np.poly([-1.0 / one_s, -1.0 / other_s]).tolist()
    assert judge_damping(denominator, DAMPED) == Verdict.TRUSTED


@given(st.floats(-1.0, 2.0), st.floats(0.01, 1e3))
def test_a_pair_is_refused_below_the_smallest_damping(damping: float, tau_s: float) -> None:
    assume(abs(damping - DAMPED.damping_min) > 1e-6)
    denominator = [1.0, 2.0 * damping / tau_s, 1.0 / tau_s**2]
    refused = judge_damping(denominator, DAMPED) == Verdict.UNDERDAMPED
    assert refused == (damping < DAMPED.damping_min)


@pytest.mark.parametrize("denominator", [[1.0, math.nan, 0.01], [1.0, 0.2, math.nan]])
def test_a_damping_that_is_no_number_is_refused(denominator: list[float]) -> None:
    assert judge_damping(denominator, DAMPED) == Verdict.UNDERDAMPED


def test_a_load_of_first_order_has_no_damping_to_look_at() -> None:
    assert judge_damping([1.0, 0.1], DAMPED) == Verdict.TRUSTED


@pytest.mark.parametrize(
    ("judge", "limit", "refusal"),
    [
        (judge_load, 0.9999, Verdict.UNSTABLE_LOAD),
        (judge_loop, 0.995, Verdict.UNSTABLE_LOOP),
    ],
)
def test_poles_are_held_to_a_radius(
    judge: Callable[[list[float]], int], limit: float, refusal: Verdict
) -> None:
    turn = np.exp(0.3j)
    for radius, expected in ((limit - 1e-5, Verdict.TRUSTED), (limit + 1e-5, refusal)):
        polynomial = np.poly([radius * turn, radius / turn, 0.5]).real.tolist()
        assert judge(polynomial) == expected
    assert judge([1.0, math.nan]) == Verdict.NOT_FINITE


def test_nothing_is_trusted_before_the_warm_up_is_over() -> None:
    state = SupervisorState()
    for periods in range(1, 91):
        assert not take_verdict(state, Verdict.TRUSTED, JACKET, periods, in_force=True)
        assert not state.trusted
        assert state.verdict == Verdict.WARMING_UP
    assert take_verdict(state, Verdict.TRUSTED, JACKET, 91, in_force=True)
    assert state.trusted
    assert state.verdict == Verdict.TRUSTED


@pytest.mark.parametrize("refusal", WRONG)
def test_a_refused_estimate_keeps_the_trusted_gains_until_patience_ends(refusal: Verdict) -> None:
    state = SupervisorState(verdict=Verdict.TRUSTED, trusted=True)
    for _ in range(JACKET.patience_periods):
        assert not take_verdict(state, refusal, JACKET, 100, in_force=True)
        assert state.trusted
    take_verdict(state, refusal, JACKET, 100, in_force=True)
    assert not state.trusted
    assert state.verdict == refusal


@pytest.mark.parametrize("refusal", WRONG)
def test_without_patience_the_first_refusal_returns_to_the_fixed_gains(refusal: Verdict) -> None:
    state = SupervisorState(verdict=Verdict.TRUSTED, trusted=True)
    assert not take_verdict(state, refusal, replace(JACKET, patience_periods=0), 100, in_force=True)
    assert not state.trusted


@pytest.mark.parametrize("doubt", [Verdict.UNCERTAIN, Verdict.FRAGILE, Verdict.UNDERDAMPED])
def test_doubt_leaves_gains_that_wait_as_they_are(doubt: Verdict) -> None:
    state = SupervisorState(verdict=Verdict.TRUSTED, trusted=True, good_periods=9)
    for _ in range(100 * JACKET.patience_periods):
        assert not take_verdict(state, doubt, JACKET, 100, in_force=False)
        assert state.trusted


@pytest.mark.parametrize("doubt", [Verdict.UNCERTAIN, Verdict.FRAGILE, Verdict.UNDERDAMPED])
def test_doubt_that_comes_up_under_the_gains_in_force_loses_them(doubt: Verdict) -> None:
    hasty = replace(JACKET, patience_periods=0)
    state = SupervisorState(verdict=Verdict.TRUSTED, trusted=True, good_periods=9)
    assert not take_verdict(state, doubt, hasty, 100, in_force=True)
    assert not state.trusted


def test_patience_counts_refusals_in_a_row() -> None:
    state = SupervisorState(verdict=Verdict.TRUSTED, trusted=True)
    for verdict in [Verdict.NOT_FINITE, Verdict.NOT_FINITE, Verdict.TRUSTED] * 10:
        take_verdict(state, verdict, JACKET, 100, in_force=True)
        assert state.trusted


@given(st.lists(st.sampled_from([*WRONG, Verdict.TRUSTED]), max_size=120))
def test_trust_needs_warm_up_and_a_trusted_estimate_within_patience(
    verdicts: list[Verdict],
) -> None:
    state = SupervisorState()
    for periods, verdict in enumerate(verdicts, 1):
        accepted = take_verdict(state, verdict, JACKET, periods, in_force=True)
        recent = verdicts[max(0, periods - 1 - JACKET.patience_periods) : periods]
        assert accepted == (verdict == Verdict.TRUSTED and periods > JACKET.warm_up_periods)
        assert not state.trusted or Verdict.TRUSTED in recent
        assert not state.trusted or periods > JACKET.warm_up_periods
