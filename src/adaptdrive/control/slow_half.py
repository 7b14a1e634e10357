"""The slow half of the controller: one call per slow period T_k.

Sample, learn, judge, redesign, act: the estimator takes in the sample, the supervisor judges the
estimate, the design turns a trusted one into gains, and the law in force computes the new input
on the history that both laws share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control import estimator as est
from adaptdrive.control import regression as reg
from adaptdrive.control import supervisor as sup
from adaptdrive.control.charging import ChargeState, taper, terminal_voltage
from adaptdrive.control.compensator import control_law, lead_reference
from adaptdrive.control.continuous import continuous_model
from adaptdrive.control.design import compensator_gains, discrete_model, past_inputs, reference_lead
from adaptdrive.control.load import Load, to_input
from adaptdrive.control.pace import Pace, paced_pole
from adaptdrive.control.pole_placement import closed_loop_polynomial
from adaptdrive.control.rls import predict
from adaptdrive.control.robustness import STABLE_RADIUS, closes_stably, stands_uncertainty
from adaptdrive.control.settings import ControllerSettings, Jacket
from adaptdrive.control.vectors import Vector, copy_into, shift_in, total
from adaptdrive.control.watch import (
    Fallback,
    WatchState,
    is_unresponsive,
    latch_fallback,
    watch_loop,
)

_RETUNE = 1e-4
_HELD_SHARE = 0.1


@dataclass(slots=True)
class SlowState:
    """What the slow half remembers.

    Attributes:
        inputs: u[k-1] ... u[k-n] as applied.
        outputs: y[k] ... y[k-m].
        nominal: Nominal physical parameters.
        fixed_gains: Gains for the nominal model.
        adaptive_gains: Gains for the last accepted estimate.
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
        deviations: Standard deviations of the physical parameters.
        model_a: A of this period's estimate.
        model_b: B of it.
        trusted_a: A of the last trusted estimate.
        trusted_b: B of it.
        trusted_alarms: Abrupt changes noticed when it was accepted.
        saturated: Whether the last input was at a limit or could not be followed.
        blend: Share of the adaptive law in what is sent, 0 to 1.
        watch: The watch over the adaptive law.
        pace: The pace of the loop.
        pole_in_force: Pole of this period's designs.
        unresponsive: Whether the load has stopped to answer.
    """

    inputs: Vector
    outputs: Vector
    nominal: Vector
    fixed_gains: Vector
    adaptive_gains: Vector
    values: Vector
    pole: float
    period_s: float
    handover_step: float
    accepted: bool
    adaptive: bool
    estimator: est.EstimatorState
    supervisor: sup.SupervisorState
    charge: ChargeState
    reference: float
    nominal_theta: Vector
    deviations: Vector
    watch: WatchState
    pace: Pace
    model_a: Vector
    model_b: Vector
    trusted_a: Vector
    trusted_b: Vector
    trusted_alarms: int = 0
    saturated: bool = False
    blend: float = 0.0
    pole_in_force: float = math.nan
    unresponsive: bool = False


@dataclass(slots=True)
class SlowSample:
    """What the slow half is given each period.

    Attributes:
        period_s: T_k.
        output: y[k].
        output_filtered: λy ... λ^m y.
        input_filtered: u, λu ... λ^m u.
        applied: Input applied over the elapsed period, NaN while unknown.
        followed: False where a limit kept the drive from following.
        held_share: Share of the elapsed ticks without a fresh measurement.
        reference: r[k].
        adaptive: True when the operator asks for the adaptive controller.
        pole: Pole asked for.
        low: Lowest input.
        high: Highest input.
    """

    period_s: float
    output: float
    output_filtered: Vector
    input_filtered: Vector
    applied: float
    followed: bool
    held_share: float
    reference: float
    adaptive: bool
    pole: float
    low: float
    high: float


def new_slow_state(
    settings: ControllerSettings, load: Load, output: float, boost_voltage_V: float
) -> SlowState:
    """A slow half at rest: the present output and voltage have been there for ever."""
    taps = past_inputs(settings, load)
    load_input = to_input(boost_voltage_V, load.input_gain, load.input_exponent)
    nominal = load.physical(list(load.numerator), list(load.denominator))
    return SlowState(
        inputs=[load_input] * taps,
        outputs=[output] * (load.order + 1),
        nominal=nominal,
        fixed_gains=[0.0] * (taps + load.order + 1),
        adaptive_gains=[0.0] * (taps + load.order + 1),
        values=[math.nan] * len(nominal),
        pole=math.nan,
        period_s=math.nan,
        handover_step=math.nan,
        accepted=False,
        adaptive=False,
        estimator=est.new_estimator(settings.learning, load, taps),
        supervisor=sup.SupervisorState(),
        charge=ChargeState(max(0.0, output)),
        reference=output,
        nominal_theta=reg.nominal_theta(settings.learning, load, taps),
        deviations=[math.nan] * len(nominal),
        watch=WatchState(),
        pace=Pace(),
        model_a=[1.0] + [0.0] * load.order,
        model_b=[0.0] * (taps + 1),
        trusted_a=[1.0] + [0.0] * load.order,
        trusted_b=[0.0] * (taps + 1),
    )


def slow_step(
    settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample
) -> float:
    """One slow period.

    Args:
        settings: Designs, rates and rules.
        load: The load.
        state: Overwritten.
        sample: What was measured and asked for.

    Returns:
        The load's input u[k] after limits.
    """
    if not sample.followed and math.isfinite(sample.applied):
        state.inputs[0] = sample.applied
        state.saturated = True
    _take_sample(settings, load, state, sample)
    jacket = settings.jacket
    state.pole_in_force = sample.pole
    if jacket.paced:
        state.pole_in_force = paced_pole(state.pace, sample.pole, state.saturated)
    _design_fixed(settings, load, state, sample)
    _adapt(settings, load, state, sample)
    reference = _governed_reference(load, state, sample)
    _look_at_loop(jacket, state, sample, reference)
    led = lead_reference(reference, state.reference, reference_lead(settings))
    state.reference = reference
    return _act(jacket, state, sample, led)


def _take_sample(
    settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample
) -> None:
    learning, estimator = settings.learning, state.estimator
    estimator.elapsed_s += sample.period_s
    if learning.filtered:
        reg.fill_filtered_regressor(
            estimator.regressor, learning, load, sample.output_filtered, sample.input_filtered
        )
        reg.fill_initial_state(estimator.regressor, learning, load, estimator.elapsed_s)
    else:
        reg.fill_direct_regressor(estimator.regressor, learning, load, state.outputs, state.inputs)
    moved = abs(sample.output - state.outputs[0]) >= learning.dead_band
    usable = moved and sample.held_share <= _HELD_SHARE
    target = reg.learning_target(learning, sample.output, sample.output_filtered)
    est.learn(estimator, learning, load, target, usable)
    if learning.filtered:
        fixed = target / learning.output_scale - predict(state.nominal_theta, estimator.regressor)
        own = est.own_residual(estimator, learning)
        sup.compare_residuals(state.supervisor, own, fixed * fixed)
    shift_in(state.outputs, sample.output)


def _design_fixed(
    settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample
) -> None:
    drifted = not abs(sample.period_s - state.period_s) <= _RETUNE * sample.period_s
    if not drifted and state.pole_in_force == state.pole:
        return
    numerator, denominator = list(load.numerator), list(load.denominator)
    a, b = discrete_model(settings, load, numerator, denominator, sample.period_s)
    copy_into(state.fixed_gains, compensator_gains(a, b, load.order, state.pole_in_force))
    state.period_s, state.pole = sample.period_s, state.pole_in_force


def _adapt(settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample) -> None:
    """Judge the estimate and, if it is trusted, make gains of it."""
    gains = [0.0] * len(state.adaptive_gains)
    verdict = _redesign(settings, load, state, sample, gains)
    periods = state.estimator.periods
    state.accepted = sup.take_verdict(
        state.supervisor, verdict, settings.jacket, periods, state.adaptive
    )
    if state.accepted:
        _take_gains(settings.jacket, state, gains)
        state.trusted_a, state.trusted_b = state.model_a, state.model_b
        state.trusted_alarms = state.estimator.surprise.alarms


def _take_gains(jacket: Jacket, state: SlowState, gains: Vector) -> None:
    """New gains: those in force move towards them, those that only wait are replaced."""
    share = jacket.gain_slew
    if share >= 1.0 or not state.adaptive:
        copy_into(state.adaptive_gains, gains)
        return
    for i in range(len(gains)):
        state.adaptive_gains[i] += share * (gains[i] - state.adaptive_gains[i])


def _redesign(
    settings: ControllerSettings,
    load: Load,
    state: SlowState,
    sample: SlowSample,
    gains: Vector,
) -> int:
    a, b, verdict = _estimated_model(settings, load, state, sample.period_s)
    if verdict != sup.Verdict.TRUSTED:
        return verdict
    verdict = sup.judge_load(a)
    if verdict != sup.Verdict.TRUSTED:
        return verdict
    copy_into(gains, compensator_gains(a, b, load.order, state.pole_in_force))
    taps = len(state.inputs)
    r = [1.0, *gains[:taps]]
    verdict = sup.judge_loop(closed_loop_polynomial(a, b, r, gains[taps:]))
    if verdict != sup.Verdict.TRUSTED:
        return verdict
    state.model_a, state.model_b = a, b
    return _judge_robustness(settings, load, state, gains, sample.period_s)


def _judge_robustness(
    settings: ControllerSettings, load: Load, state: SlowState, gains: Vector, period_s: float
) -> int:
    """Whether the gains stand what the estimate may be wrong by, and the last trusted load."""
    if not settings.jacket.confidence > 0.0:
        return sup.Verdict.TRUSTED
    values, deviations = state.values, state.deviations
    if not stands_uncertainty(settings, load, gains, values, deviations, period_s):
        return sup.Verdict.FRAGILE
    changed = state.estimator.surprise.alarms != state.trusted_alarms
    if changed or not state.supervisor.trusted:
        return sup.Verdict.TRUSTED
    a, b = state.trusted_a, state.trusted_b
    stable = closes_stably(gains, a, b, load.order, STABLE_RADIUS)
    return sup.Verdict.TRUSTED if stable else sup.Verdict.AT_ODDS


def _estimated_model(
    settings: ControllerSettings, load: Load, state: SlowState, period_s: float
) -> tuple[Vector, Vector, int]:
    """A, B of the estimate, and what the supervisor says of its parameters."""
    learning, theta = settings.learning, state.estimator.theta
    if not learning.filtered:
        a, b = reg.direct_model(theta, learning, load)
        _show_direct(load, state, a, b, period_s)
        return a, b, sup.judge_load(a)
    numerator, denominator = reg.filtered_model(theta, learning, load)
    verdict = sup.judge_model(numerator, denominator)
    if verdict != sup.Verdict.TRUSTED:
        return denominator, numerator, verdict
    copy_into(state.values, load.physical(numerator, denominator))
    verdict = sup.judge_bounds(state.values, state.nominal, settings.jacket, state.supervisor)
    if verdict == sup.Verdict.TRUSTED:
        verdict = sup.judge_damping(denominator, settings.jacket)
    if verdict == sup.Verdict.TRUSTED:
        verdict = _judge_quality(settings, load, state)
    if verdict != sup.Verdict.TRUSTED:
        return denominator, numerator, verdict
    a, b = discrete_model(settings, load, numerator, denominator, period_s)
    return a, b, verdict


def _judge_quality(settings: ControllerSettings, load: Load, state: SlowState) -> int:
    """Whether the estimate is certain enough, and predicts no worse than the nominal model."""
    learning, jacket, supervisor = settings.learning, settings.jacket, state.supervisor
    if jacket.deviation_max > 0.0:
        deviations = est.parameter_deviations(state.estimator, learning, load, state.values)
        copy_into(state.deviations, deviations)
    verdict = sup.judge_certainty(state.values, state.deviations, jacket, supervisor)
    if verdict != sup.Verdict.TRUSTED:
        return verdict
    return sup.judge_residual(supervisor, jacket)


def _show_direct(load: Load, state: SlowState, a: Vector, b: Vector, period_s: float) -> None:
    """Physical parameters of a direct estimate, for people: its gains do without them."""
    numerator, denominator = continuous_model(a, b, period_s)
    if sup.judge_model(numerator, denominator) == sup.Verdict.TRUSTED:
        copy_into(state.values, load.physical(numerator, denominator))
    else:
        copy_into(state.values, [math.nan] * len(state.values))


def _governed_reference(load: Load, state: SlowState, sample: SlowSample) -> float:
    """The reference, lowered where the load must be spared."""
    charging = load.charging
    if charging is None:
        return sample.reference
    terminal_V = terminal_voltage(charging, sample.input_filtered[0], sample.output)
    return taper(charging, state.charge, sample.reference, terminal_V, sample.output)


def _look_at_loop(jacket: Jacket, state: SlowState, sample: SlowSample, reference: float) -> None:
    """Return to the fixed controller, and stay there, when the loop is in trouble."""
    watch, error = state.watch, reference - sample.output
    reason = watch_loop(
        watch,
        jacket,
        error,
        sample.output,
        state.pole_in_force,
        sample.held_share,
        state.saturated,
    )
    latch_fallback(watch, reason, sample.adaptive)
    state.unresponsive = is_unresponsive(watch, jacket)


def _act(jacket: Jacket, state: SlowState, sample: SlowSample, reference: float) -> float:
    """Both laws on the shared history; what is sent is limited and remembered."""
    sound = state.supervisor.trusted and state.watch.fallback == Fallback.NONE
    state.adaptive = sample.adaptive and sound
    fixed = control_law(state.fixed_gains, state.inputs, state.outputs, reference)
    other = control_law(state.adaptive_gains, state.inputs, state.outputs, reference)
    ready = total(state.adaptive_gains) != 0.0
    step = fixed - other if state.adaptive else other - fixed
    state.handover_step = step if ready else math.nan
    wanted = _blended(jacket, state, fixed, other)
    if not math.isfinite(wanted):
        wanted = state.inputs[0]
    limited = min(max(wanted, sample.low), sample.high)
    state.saturated = limited != wanted
    shift_in(state.inputs, limited)
    return limited


def _blended(jacket: Jacket, state: SlowState, fixed: float, other: float) -> float:
    """From one law to the other over some periods, so that even with an error nothing jumps."""
    share = 1.0 / jacket.blend_periods
    if state.adaptive:
        state.blend = min(1.0, state.blend + share)
    else:
        state.blend = max(0.0, state.blend - share)
    if state.blend <= 0.0:
        return fixed
    if state.blend >= 1.0:
        return other
    return fixed + state.blend * (other - fixed)
