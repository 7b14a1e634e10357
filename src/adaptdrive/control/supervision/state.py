"""State of the slow half between periods, and its reasons for operators."""

import math
from dataclasses import dataclass

from adaptdrive.control import signals, thresholds
from adaptdrive.control.design import noise, pole_placement
from adaptdrive.control.design.reference import ReferenceFilter, new_reference_filter
from adaptdrive.control.estimation.estimator import EstimatorState, new_estimator, nominal_theta
from adaptdrive.control.estimation.methods import METHODS
from adaptdrive.control.loads.battery import ChargeState
from adaptdrive.control.loads.load import Load, to_input
from adaptdrive.control.settings import ControllerSettings, Probing, SupervisionLimits
from adaptdrive.control.supervision.monitor import (
    FAR_BETTER,
    Fallback,
    LimitCycleState,
    MonitorState,
)
from adaptdrive.control.supervision.supervisor import SupervisorState, Verdict, better_than_nominal
from adaptdrive.control.vectors import Vector

# State of the slow half between periods.


@dataclass(slots=True)
class ProbeState:
    """State of the probing.

    Attributes:
        age_periods: Slow periods of the present probe, 0 without one.
        rest_periods: Slow periods in a row at rest on the same constant set-point.
        pause_periods: Slow periods until the next probe may begin.
        reference: Set-point of the last slow period, not moved.
        shift: How far it is moved.
    """

    age_periods: int = 0
    rest_periods: int = 0
    pause_periods: int = 0
    reference: float = math.nan
    shift: float = 0.0


@dataclass(slots=True)
class SlowState:
    """State of the slow half between periods.

    Attributes:
        inputs: u[k-1] ... u[k-n] as applied; where a limit cuts noise off, with it.
        outputs: y[k] ... y[k-m].
        nominal: Nominal physical parameters.
        fixed_gains: Gains for the nominal model.
        adaptive_gains: Gains for the last accepted estimate, of the quiet law.
        fast_gains: The same of the law that acts.
        fast_loop: A_c of these; zeros before there is a design.
        values: Estimated physical parameters.
        pole: Pole that the fixed gains were designed for.
        period_s: Period that they were designed for.
        handover_step: Law not in force minus law in force.
        accepted: Whether the estimate of this period went live.
        adaptive: Whether the adaptive law is in force.
        estimator: The estimator.
        supervisor: The supervisor.
        charge: The charger of a battery.
        reference: r[k-1].
        nominal_theta: θ of the nominal model.
        possible: Models within the covariance of the estimate (`pole_placement`).
        spread: How far the response may be off within the covariance, as a share of a step.
        model_a: A of this period's estimate.
        model_b: B of it.
        equation: That of A and B (`pole_placement`), NaNs before the first.
        trusted_a: A of the last trusted estimate.
        trusted_b: B of it.
        reference_filter: Reference filter of the adaptive law, and its preview.
        new_loop: A_c of the design of this period.
        circle: What margins need of the unit circle (`noise`).
        expected: Response to the reference that was asked for, a lag for each pole.
        recalled: Whether the estimate is what a run before this one had trusted.
        saturated: Whether the last input was at a limit or could not be followed.
        blend: Share of the adaptive law in what is sent, 0 to 1.
        sent: The input in force, within its limits.
        input_noise: σ_u of the quiet law, with the noise that is counted at the least.
        fast_noise: σ_u of the law that acts.
        watch: The watch over the adaptive law.
        unresponsive: Whether the load has stopped to answer.
        cycles: The watch over the fixed law.
        probe: The probing.
        cycling: Whether the fixed law is in a limit cycle.
    """

    inputs: Vector
    outputs: Vector
    nominal: Vector
    fixed_gains: Vector
    adaptive_gains: Vector
    fast_gains: Vector
    fast_loop: Vector
    values: Vector
    pole: float
    period_s: float
    handover_step: float
    accepted: bool
    adaptive: bool
    estimator: EstimatorState
    supervisor: SupervisorState
    charge: ChargeState
    reference: float
    nominal_theta: Vector
    possible: Vector
    spread: float
    watch: MonitorState
    cycles: LimitCycleState
    probe: ProbeState
    model_a: Vector
    model_b: Vector
    equation: Vector
    trusted_a: Vector
    trusted_b: Vector
    reference_filter: ReferenceFilter
    new_loop: Vector
    circle: Vector
    expected: Vector
    recalled: bool = False
    saturated: bool = False
    blend: float = 0.0
    sent: float = 0.0
    input_noise: float = 0.0
    fast_noise: float = 0.0
    unresponsive: bool = False
    cycling: bool = False


def new_slow_state(
    settings: ControllerSettings, load: Load, output: float, boost_voltage_V: float
) -> SlowState:
    """A slow half at rest: the present output and voltage have been there for ever."""
    taps, method = pole_placement.past_inputs(settings, load), METHODS[settings.learning.method]
    load_input = to_input(boost_voltage_V, load.input_gain, load.input_exponent)
    nominal = load.physical(list(load.numerator), list(load.denominator))
    resting = output
    if load.charging is not None:  # its EMF is not in the model
        resting = load_input * load.gain
    return SlowState(
        inputs=[load_input] * taps,
        outputs=[output] * (load.order + 1),
        nominal=nominal,
        fixed_gains=[0.0] * (taps + load.order + 1),
        adaptive_gains=[0.0] * (taps + load.order + 1),
        fast_gains=[0.0] * (taps + load.order + 1),
        fast_loop=[0.0] * (load.order + taps + 1),
        values=[math.nan] * len(nominal),
        pole=math.nan,
        period_s=math.nan,
        handover_step=math.nan,
        accepted=False,
        adaptive=False,
        estimator=new_estimator(method, settings.learning, load, taps),
        supervisor=SupervisorState(),
        charge=ChargeState(max(0.0, output)),
        reference=output,
        nominal_theta=nominal_theta(method, settings.learning, load, taps),
        possible=[math.nan] * ((2 * len(nominal) + 1) * (load.order + taps + 2)),
        spread=math.nan,
        watch=MonitorState(fast=resting, slow=resting),
        cycles=LimitCycleState(),
        probe=ProbeState(),
        model_a=[1.0] + [0.0] * load.order,
        model_b=[0.0] * (taps + 1),
        equation=[math.nan] * ((load.order + taps) * (load.order + taps + 1)),
        trusted_a=[1.0] + [0.0] * load.order,
        trusted_b=[0.0] * (taps + 1),
        reference_filter=new_reference_filter(load.order, taps),
        new_loop=[0.0] * (load.order + taps + 1),
        circle=noise.unit_circle(load.order + taps + 1),
        expected=[output] * (2 * load.order),
        sent=load_input,
    )


# Reasons why the adaptive law is not in force or may no longer fit the load, for operators.

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
_RETURN = f"adaptive returns {thresholds.WINDOW} slow periods after the cause is gone"


def reason(
    state: SlowState,
    supervision: SupervisionLimits,
    probing: Probing,
    load: Load,
    mode: signals.Mode,
) -> str:
    """Return why the adaptive law is not in force, or how old what it knows is, and any probe.

    Args:
        state: The slow half.
        supervision: Limits of the supervisor.
        probing: When information is old.
        load: Names of the parameters.
        mode: Mode that is asked for.
    """
    why = _why(state, supervision, load, mode) or _age(state, probing)
    if state.probe.age_periods == 0:
        return why
    probes = f"probing: the set-point is moved by {state.probe.shift:+.3g} to learn the load"
    return f"{why}; {probes}" if why else probes


def _why(state: SlowState, supervision: SupervisionLimits, load: Load, mode: signals.Mode) -> str:
    """Return why the adaptive law is not in force, empty where it is."""
    if state.watch.fallback != Fallback.NONE:
        latched = state.watch.fallback == Fallback.OSCILLATING
        cause = _FALLBACKS[Fallback(state.watch.fallback)]
        return f"{cause}; {_RELEASE if latched else _RETURN}"
    verdict = Verdict(state.supervisor.verdict)
    if verdict is Verdict.TRUSTED:
        return "" if mode is signals.Mode.ADAPTIVE else f"mode {mode} asked for"
    if verdict is Verdict.WARMING_UP:
        return f"warming up: needs {supervision.warm_up_periods} slow periods"
    if verdict is Verdict.OUT_OF_BOUNDS:
        return _out_of_bounds(state, supervision, load)
    if verdict is Verdict.UNCERTAIN:
        return _uncertain(state, supervision)
    return _REASONS[verdict]


def _age(state: SlowState, probing: Probing) -> str:
    """Return that nothing has shown the load for long, empty where something has."""
    if not 0 < probing.stale_periods < state.estimator.unseen_periods:
        return ""
    return (
        f"the load may have changed: nothing has shown it for over {probing.stale_periods} "
        "slow periods, and the next step may overshoot"
    )


def _uncertain(state: SlowState, supervision: SupervisionLimits) -> str:
    if not math.isfinite(state.spread):
        return "the estimate does not show yet what its loop would do"
    spread, limit = 100.0 * state.spread, 100.0 * supervision.spread_max
    return f"response is uncertain: ±{spread:.3g} % of a step, limit {limit:g} %"


def _out_of_bounds(state: SlowState, supervision: SupervisionLimits, load: Load) -> str:
    index = state.supervisor.out_of_bounds
    nominal = state.nominal[index]
    low, high = supervision.ratio_min * nominal, supervision.ratio_max * nominal
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
