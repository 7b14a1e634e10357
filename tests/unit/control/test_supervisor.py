"""The supervisor's verdicts and warm-up, and what ends its trust."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from adaptdrive.control.settings import SupervisionLimits
from adaptdrive.control.supervision.supervisor import (
    Supervisor,
    Verdict,
    judge_model,
    judge_poles,
)

JACKET = SupervisionLimits(warm_up_periods=90, ratio_min=0.2, ratio_max=8.0, revokes=True)
DAMPED = replace(JACKET, damping_min=0.8)
NOMINAL = [0.011, 21.7, -117.0]
OVERDAMPED = [1.0, 0.2, 0.001]
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
    judge = Supervisor(JACKET, NOMINAL)
    values = [n * share for n, share in zip(NOMINAL, good, strict=True)]
    within = [value / n for value, n in zip(values, NOMINAL, strict=True)]
    assume(0.2 <= min(within) <= max(within) <= 8.0)  # rounding aside
    assert judge.judge_parameters(values, OVERDAMPED) == Verdict.TRUSTED
    assert judge.out_of_bounds(values) == -1
    values[index] = NOMINAL[index] * ratio
    assert judge.judge_parameters(values, OVERDAMPED) == Verdict.OUT_OF_BOUNDS
    assert judge.out_of_bounds(values) == index


def damping_of(denominator: list[float]) -> int:
    """The verdict on a model whose parameters are nominal."""
    return Supervisor(DAMPED, NOMINAL).judge_parameters(NOMINAL, denominator)


@given(st.floats(0.01, 1e3), st.floats(0.01, 1e3))
def test_every_load_with_real_time_constants_is_damped_enough(one_s: float, other_s: float) -> None:
    denominator = np.poly([-1.0 / one_s, -1.0 / other_s]).tolist()
    assert damping_of(denominator) == Verdict.TRUSTED


@given(st.floats(-1.0, 2.0), st.floats(0.01, 1e3))
def test_a_pair_is_refused_below_the_smallest_damping(damping: float, tau_s: float) -> None:
    assume(abs(damping - DAMPED.damping_min) > 1e-6)
    denominator = [1.0, 2.0 * damping / tau_s, 1.0 / tau_s**2]
    refused = damping_of(denominator) == Verdict.UNDERDAMPED
    assert refused == (damping < DAMPED.damping_min)
    for bad in ([1.0, math.nan, denominator[2]], [1.0, denominator[1], math.nan]):
        assert damping_of(bad) == Verdict.UNDERDAMPED
    assert damping_of([1.0, 1.0 / tau_s]) == Verdict.TRUSTED  # of first order


@pytest.mark.parametrize("refusal", [Verdict.UNSTABLE_LOAD, Verdict.UNSTABLE_LOOP])
def test_poles_are_held_to_a_radius(refusal: Verdict) -> None:
    limit, turn = 0.9999, np.exp(0.3j)
    for radius, expected in ((limit - 1e-5, Verdict.TRUSTED), (limit + 1e-5, refusal)):
        polynomial = np.poly([radius * turn, radius / turn, 0.5]).real.tolist()
        assert judge_poles(polynomial, refusal) == expected
    assert judge_poles([1.0, math.nan], refusal) == Verdict.NOT_FINITE


def trusting(limits: SupervisionLimits = JACKET, good_periods: int = 0) -> Supervisor:
    """A supervisor that trusts gains, after so many good estimates in a row."""
    judge = Supervisor(limits, NOMINAL)
    judge.verdict, judge.trusted, judge.good_periods = Verdict.TRUSTED, True, good_periods
    return judge


@pytest.mark.parametrize("refusal", WRONG)
@pytest.mark.parametrize("revokes", [False, True])
@pytest.mark.parametrize("in_force", [False, True])
def test_a_refused_estimate_never_acts_and_ends_the_trust_where_it_may_be_revoked(
    refusal: Verdict, *, revokes: bool, in_force: bool
) -> None:
    judge = trusting(replace(JACKET, revokes=revokes))
    for _ in range(100):
        assert not judge.take_verdict(refusal, 100, in_force=in_force)
        assert judge.trusted is not revokes
        assert judge.verdict == refusal


@pytest.mark.parametrize("doubt", [Verdict.UNCERTAIN, Verdict.UNDERDAMPED])
@pytest.mark.parametrize("in_force", [False, True])
@pytest.mark.parametrize("revokes", [False, True])
def test_doubt_loses_only_the_gains_under_which_it_comes_up(
    doubt: Verdict, *, in_force: bool, revokes: bool
) -> None:
    judge = trusting(replace(JACKET, revokes=revokes), good_periods=9)
    for _ in range(100):
        assert not judge.take_verdict(doubt, 100, in_force=in_force)
        assert judge.trusted is not (in_force and revokes)


@given(
    st.lists(st.sampled_from([*WRONG, Verdict.TRUSTED]), max_size=30),
    st.booleans(),
    st.integers(0, 9),
)
def test_trust_begins_after_the_warm_up_and_lasts_until_a_refusal_that_revokes_it(
    verdicts: list[Verdict], revokes: bool, warm_up: int
) -> None:
    limits = replace(JACKET, revokes=revokes, warm_up_periods=warm_up)
    judge, earlier = Supervisor(limits, NOMINAL), False
    for periods, verdict in enumerate(verdicts, 1):
        accepted = judge.take_verdict(verdict, periods, in_force=True)
        assert accepted == (verdict == Verdict.TRUSTED and periods > warm_up)
        assert judge.trusted == (accepted or (earlier and not revokes))
        earlier = earlier or accepted
        warming = verdict == Verdict.TRUSTED and not accepted
        assert judge.verdict == (Verdict.WARMING_UP if warming else verdict)


CRITICAL = replace(JACKET, residual_margin=1.5)


def compared(own: list[float], fixed: list[float], limits: SupervisionLimits) -> Supervisor:
    """A supervisor that has seen innovations of the estimate and of the nominal model."""
    judge = Supervisor(limits, NOMINAL)
    for one, other in zip(own, fixed, strict=True):
        judge.compare_residuals(one * one, other)
    return judge


@pytest.mark.parametrize(("ratio", "worse"), [(1.49, False), (1.51, True)])
def test_an_estimate_that_predicts_worse_than_the_nominal_model_is_refused(
    ratio: float, worse: bool
) -> None:
    own, fixed = [0.1 * ratio] * 400, [0.1] * 400
    expected = Verdict.WORSE_THAN_FIXED if worse else Verdict.TRUSTED
    assert compared(own, fixed, CRITICAL).judge_residual() == expected
    assert compared(own, fixed, JACKET).judge_residual() == Verdict.TRUSTED


def test_doubt_counts_only_where_a_good_estimate_came_before_it() -> None:
    """Doubt without one is lack of excitation, as long as it lasts, whatever law is in force."""
    judge = trusting(good_periods=1)
    for in_force in [False] + [True] * 100:
        judge.take_verdict(Verdict.UNCERTAIN, 100, in_force=in_force)
        assert judge.trusted
    assert judge.take_verdict(Verdict.TRUSTED, 100, in_force=True)
    judge.take_verdict(Verdict.UNCERTAIN, 100, in_force=True)
    assert not judge.trusted


def test_estimates_must_be_good_for_a_while_before_the_first_goes_live() -> None:
    judge = Supervisor(replace(JACKET, dwell_periods=3), NOMINAL)
    course = [Verdict.TRUSTED] * 2 + [Verdict.UNSTABLE_LOOP] + [Verdict.TRUSTED] * 4
    found = [judge.take_verdict(verdict, 200, in_force=False) for verdict in course]
    assert found == [False] * 5 + [True] * 2
    judge.take_verdict(Verdict.UNCERTAIN, 200, in_force=False)
    assert not judge.take_verdict(Verdict.TRUSTED, 200, in_force=False)
    assert judge.verdict == Verdict.SETTLING
    assert judge.trusted
