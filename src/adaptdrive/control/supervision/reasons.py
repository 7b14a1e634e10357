"""Reasons why the adaptive law is not in force or may no longer fit the load, for operators."""

from __future__ import annotations

import math

from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import Jacket, Probing
from adaptdrive.control.signals import Mode
from adaptdrive.control.slow_state import SlowState
from adaptdrive.control.supervision.monitor import FAR_BETTER, Fallback
from adaptdrive.control.supervision.supervisor import Verdict, better_than_nominal
from adaptdrive.control.thresholds import WINDOW

_REASONS = {
    Verdict.NOT_FINITE: "estimate is not finite",
    Verdict.UNSTABLE_LOAD: "estimated load is unstable",
    Verdict.UNSTABLE_LOOP: "designed loop would be unstable",
    Verdict.WORSE_THAN_FIXED: "estimate predicts worse than the nominal model",
    Verdict.UNDERDAMPED: "estimate swings as no such load does",
    Verdict.SETTLING: "estimate is good, but not yet for long enough",
}

_FALLBACKS = {
    Fallback.SATURATED: "fell back: input at its limit for too long",
    Fallback.ERROR: "fell back: large error although the input was free",
    Fallback.OSCILLATING: "fell back: growing oscillation",
    Fallback.BLIND: "fell back: measurements failed",
}

_RELEASE = "choose a slower pole, then fixed, and adaptive one slow period later"
_RETURN = f"adaptive returns {WINDOW} slow periods after the cause is gone"


def reason(state: SlowState, jacket: Jacket, probing: Probing, load: Load, mode: Mode) -> str:
    """Return why the adaptive law is not in force, or how old what it knows is, and any probe.

    Args:
        state: The slow half.
        jacket: Limits of the supervisor.
        probing: When information is old.
        load: Names of the parameters.
        mode: Mode that is asked for.
    """
    why = _why(state, jacket, load, mode) or _age(state, probing)
    if state.probe.age_periods == 0:
        return why
    probes = f"probing: the set-point is moved by {state.probe.shift:+.3g} to learn the load"
    return f"{why}; {probes}" if why else probes


def _why(state: SlowState, jacket: Jacket, load: Load, mode: Mode) -> str:
    """Return why the adaptive law is not in force, empty where it is."""
    if state.watch.fallback != Fallback.NONE:
        latched = state.watch.fallback == Fallback.OSCILLATING
        cause = _FALLBACKS[Fallback(state.watch.fallback)]
        return f"{cause}; {_RELEASE if latched else _RETURN}"
    verdict = Verdict(state.supervisor.verdict)
    if verdict is Verdict.TRUSTED:
        return "" if mode is Mode.ADAPTIVE else f"mode {mode} asked for"
    if verdict is Verdict.WARMING_UP:
        return f"warming up: needs {jacket.warm_up_periods} slow periods"
    if verdict is Verdict.OUT_OF_BOUNDS:
        return _out_of_bounds(state, jacket, load)
    if verdict is Verdict.UNCERTAIN:
        return _uncertain(state, jacket)
    return _REASONS[verdict]


def _age(state: SlowState, probing: Probing) -> str:
    """Return that nothing has shown the load for long, empty where something has."""
    if not 0 < probing.stale_periods < state.estimator.unseen_periods:
        return ""
    return (
        f"the load may have changed: nothing has shown it for over {probing.stale_periods} "
        "slow periods, and the next step may overshoot"
    )


def _uncertain(state: SlowState, jacket: Jacket) -> str:
    if not math.isfinite(state.spread):
        return "the estimate does not show yet what its loop would do"
    spread, limit = 100.0 * state.spread, 100.0 * jacket.spread_max
    return f"response is uncertain: ±{spread:.3g} % of a step, limit {limit:g} %"


def _out_of_bounds(state: SlowState, jacket: Jacket, load: Load) -> str:
    index = state.supervisor.culprit
    nominal = state.nominal[index]
    low, high = jacket.ratio_min * nominal, jacket.ratio_max * nominal
    name, value = load.names[index], state.values[index]
    text = f"estimate {name} = {value:.4g} outside {low:.4g}…{high:.4g}"
    better = better_than_nominal(state.supervisor)
    ratio = value / nominal
    if not (better > FAR_BETTER and 0.0 < ratio < math.inf):
        return text
    contrast = _contrast(name, ratio)
    return (
        f"{text}, but predicts {_times(better, 1)} better than [load.model]: the load is "
        f"{contrast} than [load.model]; commission this load"
    )


def _contrast(name: str, ratio: float) -> str:
    """Return how a load differs in a parameter, a time or another."""
    factor, larger = max(ratio, 1.0 / ratio), ratio > 1.0
    if name == "tau_product_s2":
        factor = math.sqrt(factor)
    if name.startswith("tau_"):
        return f"{_times(factor, 2)} {'slower' if larger else 'faster'}"
    return f"{_times(factor, 2)} {'larger' if larger else 'smaller'} in {name}"


def _times(factor: float, digits: int) -> str:
    """Return a factor in words: rounded, without an exponent, and at most a million."""
    rounded = float(f"{min(factor, 1e6):.{digits}g}")
    return f"{rounded:.10g} times"
