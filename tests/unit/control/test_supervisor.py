"""The supervisor's verdicts, warm-up and patience."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from adaptdrive.control.settings import SupervisionLimits
from adaptdrive.control.supervision.supervisor import (
    SupervisorState,
    Verdict,
    compare_residuals,
    judge_bounds,
    judge_damping,
    judge_model,
    judge_poles,
    judge_residual,
    take_verdict,
)

JACKET = SupervisionLimits(warm_up_periods=90, ratio_min=0.2, ratio_max=8.0, patience_periods=3)
DAMPED = replace(JACKET, damping_min=0.8)
WRONG = [
    Verdict.NOT_FINITE,
    Verdict.UNSTABLE_LOAD,
    Verdict.OUT_OF_BOUNDS,
    Verdict.UNSTABLE_LOOP,
    Verdict.WORSE_THAN_FIXED,
]


@pytest.mark.parametrize(
    ("last_b", "a1", "a2", "verdict"),
    [
        (1e-4, 0.2, 0.01, Verdict.TRUSTED),
        (math.nan, 0.2, 0.01, Verdict.NOT_FINITE),
        (1e-4, math.inf, 0.01, Verdict.NOT_FINITE),
        (1e-4, 0.2, 0.0, Verdict.NOT_FINITE),
    ],
)
def test_a_model_that_is_no_number_or_has_no_dc_gain_is_refused(
    last_b: float, a1: float, a2: float, verdict: Verdict
) -> None:
    assert judge_model([0.0, 0.0, last_b], [1.0, a1, a2]) == verdict


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize("ratio", [0.19, 8.1, -1.0, 0.0, math.nan, math.inf])
@given(good=st.lists(st.floats(0.2, 8.0), min_size=3, max_size=3))
def test_the_parameter_out_of_bounds_is_named(index: int, ratio: float, good: list[float]) -> None:
    nominal, state = [0.011, 21.7, -117.0], SupervisorState()
    values = [n * share for n, share in zip(nominal, good, strict=True)]
    within = [value / n for value, n in zip(values, nominal, strict=True)]
    assume(0.2 <= min(within) <= max(within) <= 8.0)  # rounding aside
    assert judge_bounds(values, nominal, JACKET, state) == Verdict.TRUSTED
    values[index] = nominal[index] * ratio
    assert judge_bounds(values, nominal, JACKET, state) == Verdict.OUT_OF_BOUNDS
    assert state.out_of_bounds == index


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
    for bad in ([1.0, math.nan, denominator[2]], [1.0, denominator[1], math.nan]):
        assert judge_damping(bad, DAMPED) == Verdict.UNDERDAMPED
    assert judge_damping([1.0, 1.0 / tau_s], DAMPED) == Verdict.TRUSTED  # of first order


@pytest.mark.parametrize("refusal", [Verdict.UNSTABLE_LOAD, Verdict.UNSTABLE_LOOP])
def test_poles_are_held_to_a_radius(refusal: Verdict) -> None:
    limit, turn = 0.9999, np.exp(0.3j)
    for radius, expected in ((limit - 1e-5, Verdict.TRUSTED), (limit + 1e-5, refusal)):
        polynomial = np.poly([radius * turn, radius / turn, 0.5]).real.tolist()
        assert judge_poles(polynomial, refusal) == expected
    assert judge_poles([1.0, math.nan], refusal) == Verdict.NOT_FINITE


@pytest.mark.parametrize("refusal", WRONG)
def test_a_refused_estimate_keeps_the_trusted_gains_until_patience_ends(refusal: Verdict) -> None:
    state = SupervisorState(verdict=Verdict.TRUSTED, trusted=True)
    for _ in range(JACKET.patience_periods):
        assert not take_verdict(state, refusal, JACKET, 100, in_force=True)
        assert state.trusted
    take_verdict(state, refusal, JACKET, 100, in_force=True)
    assert not state.trusted
    assert state.verdict == refusal


@pytest.mark.parametrize("doubt", [Verdict.UNCERTAIN, Verdict.UNDERDAMPED])
@pytest.mark.parametrize("in_force", [False, True])
def test_doubt_loses_only_the_gains_under_which_it_comes_up(
    doubt: Verdict, *, in_force: bool
) -> None:
    hasty = replace(JACKET, patience_periods=0)
    state = SupervisorState(verdict=Verdict.TRUSTED, trusted=True, good_periods=9)
    for _ in range(100):
        assert not take_verdict(state, doubt, hasty, 100, in_force=in_force)
        assert state.trusted is not in_force


@given(
    st.lists(st.sampled_from([*WRONG, Verdict.TRUSTED]), max_size=30),
    st.integers(0, 4),
    st.integers(0, 9),
)
def test_trust_begins_after_the_warm_up_and_lasts_as_long_as_patience(
    verdicts: list[Verdict], patience: int, warm_up: int
) -> None:
    supervision = replace(JACKET, patience_periods=patience, warm_up_periods=warm_up)
    state, good = SupervisorState(), -100
    for periods, verdict in enumerate(verdicts, 1):
        accepted = take_verdict(state, verdict, supervision, periods, in_force=True)
        assert accepted == (verdict == Verdict.TRUSTED and periods > warm_up)
        good = periods if accepted else good
        assert state.trusted == (periods - good <= patience)
        warming = verdict == Verdict.TRUSTED and not accepted
        assert state.verdict == (Verdict.WARMING_UP if warming else verdict)


CRITICAL = replace(JACKET, residual_margin=1.5)


def compared(own: list[float], fixed: list[float]) -> SupervisorState:
    """A supervisor that has seen innovations of the estimate and of the nominal model."""
    state = SupervisorState()
    for one, other in zip(own, fixed, strict=True):
        compare_residuals(state, one * one, other)
    return state


@pytest.mark.parametrize(("ratio", "worse"), [(1.49, False), (1.51, True)])
def test_an_estimate_that_predicts_worse_than_the_nominal_model_is_refused(
    ratio: float, worse: bool
) -> None:
    state = compared([0.1 * ratio] * 400, [0.1] * 400)
    expected = Verdict.WORSE_THAN_FIXED if worse else Verdict.TRUSTED
    assert judge_residual(state, CRITICAL) == expected
    assert judge_residual(state, JACKET) == Verdict.TRUSTED


def test_doubt_counts_once_it_has_come_up_under_gains_in_force() -> None:
    """Doubt without a good estimate before it is lack of excitation, as long as it lasts."""
    state = SupervisorState(verdict=Verdict.TRUSTED, trusted=True, good_periods=1)
    for _ in range(100):
        take_verdict(state, Verdict.UNCERTAIN, JACKET, 100, in_force=True)
    assert state.refused_periods == 1
    assert state.trusted


def test_estimates_must_be_good_for_a_while_before_the_first_goes_live() -> None:
    careful, state = replace(JACKET, dwell_periods=3), SupervisorState()
    course = [Verdict.TRUSTED] * 2 + [Verdict.UNSTABLE_LOOP] + [Verdict.TRUSTED] * 4
    found = [take_verdict(state, verdict, careful, 200, in_force=False) for verdict in course]
    assert found == [False] * 5 + [True] * 2
    take_verdict(state, Verdict.UNCERTAIN, careful, 200, in_force=False)
    assert not take_verdict(state, Verdict.TRUSTED, careful, 200, in_force=False)
    assert state.verdict == Verdict.SETTLING
    assert state.trusted
