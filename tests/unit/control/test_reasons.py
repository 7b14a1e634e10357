"""What operators read where the adaptive law is not in force: each reason with its figures."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from adaptdrive.control.settings import Probing
from adaptdrive.control.signals import Mode
from adaptdrive.control.supervision.monitor import Fallback
from adaptdrive.control.supervision.state import SlowState, reason
from adaptdrive.control.supervision.supervisor import Verdict
from tests.integration.closed_loop.bench import EXACT, MOTOR

JACKET = replace(EXACT.supervision, spread_max=0.05)
PROBING = Probing(stale_periods=300)
GAIN, SUM_s, PRODUCT_s2 = 0, 1, 2


def judged(verdict: Verdict) -> SlowState:
    """A slow half whose estimate got a verdict."""
    state = SlowState(EXACT, MOTOR, 3.0, 3.0 / 0.011)
    state.supervisor.verdict = verdict
    state.values = list(state.supervisor.nominal)
    state.spread = 0.01
    return state


def said(state: SlowState, mode: Mode = Mode.ADAPTIVE) -> str:
    return reason(state, JACKET, PROBING, MOTOR, mode)


def test_a_trusted_estimate_needs_no_reason_but_another_mode_that_was_asked_for() -> None:
    state = judged(Verdict.TRUSTED)
    assert said(state) == ""
    assert said(state, Mode.FIXED) == "mode fixed asked for"
    assert said(state, Mode.MANUAL) == "mode manual asked for"


def test_each_verdict_and_each_fallback_has_words_of_its_own() -> None:
    texts = [said(judged(verdict)) for verdict in Verdict if verdict is not Verdict.TRUSTED]
    for fallback in Fallback:
        state = judged(Verdict.TRUSTED)
        state.watch.fallback = fallback
        texts.append(said(state))
        latched = texts[-1].endswith("then fixed, and adaptive one slow period later")
        assert latched == (fallback is Fallback.OSCILLATING)
        returns = texts[-1].endswith("adaptive returns 20 slow periods after the cause is gone")
        assert returns == (fallback not in {Fallback.NONE, Fallback.OSCILLATING})
    assert len(set(texts)) == len(texts)
    assert texts.count("") == 1


@pytest.mark.parametrize(
    ("verdict", "spread", "text"),
    [
        (Verdict.WARMING_UP, 0.01, "warming up: needs 90 slow periods"),
        (Verdict.UNCERTAIN, 0.0825, "response is uncertain: ±8.25 % of a step, limit 5 %"),
        (Verdict.UNCERTAIN, math.nan, "the estimate does not show yet what its loop would do"),
        (Verdict.UNCERTAIN, math.inf, "the estimate does not show yet what its loop would do"),
    ],
)
def test_what_is_not_known_yet_is_named_with_its_figures(
    verdict: Verdict, spread: float, text: str
) -> None:
    state = judged(verdict)
    state.spread = spread
    assert said(state) == text


def out_of_bounds(parameter: int, ratio: float, better: float = 100.0) -> str:
    """The reason of an estimate that predicts so many times better than the nominal model."""
    state = judged(Verdict.OUT_OF_BOUNDS)
    state.values[parameter] *= ratio
    state.supervisor.own_power = 1e-4
    state.supervisor.fixed_power = 1e-4 * better * better
    return said(state)


@pytest.mark.parametrize(
    ("parameter", "ratio", "contrast"),
    [
        (GAIN, 12.0, "12 times larger in gain"),
        (GAIN, 0.125, "8 times smaller in gain"),
        (SUM_s, 9.0, "9 times slower"),
        (SUM_s, 9.874, "9.9 times slower"),
        (SUM_s, 0.1, "10 times faster"),
        (GAIN, 164.0, "160 times larger in gain"),
        (GAIN, 1e300, "1000000 times larger in gain"),
        (PRODUCT_s2, 16.0, "4 times slower"),
        (PRODUCT_s2, 1.0 / 25.0, "5 times faster"),
    ],
)
def test_a_load_that_is_another_than_configured_is_described(
    parameter: int, ratio: float, contrast: str
) -> None:
    text = out_of_bounds(parameter, ratio)
    assert f"but predicts 100 times better than [load.model]: the load is {contrast}" in text
    assert text.endswith("than [load.model]; commission this load")


@pytest.mark.parametrize(
    ("better", "times"),
    [(2.99, None), (3.0, None), (3.01, "3"), (3.4, "3"), (84.0, "80"), (96.0, "100"),
     (1e200, "1000000")],
)  # fmt: skip
def test_a_load_is_described_only_by_an_estimate_that_predicts_far_better(
    better: float, times: str | None
) -> None:
    text = out_of_bounds(GAIN, 12.0, better)
    assert ("commission" in text) is (times is not None)
    assert times is None or f"predicts {times} times better" in text
