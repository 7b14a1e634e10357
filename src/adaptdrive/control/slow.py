"""The slow half of the controller: one call per slow period T_k, up to the control law.

u[k] = - Σ r_i u[k-i] + t0 r'[k] - Σ s_j y[k-j]         t0 = Σ s_j,  1 + Σ r_i = 0
    r'[k] = r[k] + d (r[k] - r[k-1])

(26) with (28) as corrected, and (14), are of this form. The history holds the inputs that were
really applied: limited ones, and measured ones where the drive could not follow. That is the
anti-windup. Because Σ r_i = -1 and t0 = Σ s_j, any gains give the same u at rest with zero error:
that is what makes a change of gains bumpless.

The loop acts d slow periods late. The lead d on a change of the reference makes up for it: the
response is that of the loop without delay, to first order.

Sample, learn, judge, redesign, act: the estimator takes in the sample, the supervisor judges the
estimate, the design turns a trusted one into gains, and the law in force computes the new input
on the history that both laws share.
"""

import math

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.design import pole_placement
from adaptdrive.control.design.reference import (
    condition_reference,
    filter_reference,
    led_references,
    plan,
    reference_of,
    rest,
)
from adaptdrive.control.estimation import uncertainty
from adaptdrive.control.estimation.estimator import update_estimate
from adaptdrive.control.estimation.regression import SlowSample
from adaptdrive.control.estimation.rls import predict
from adaptdrive.control.loads.battery import begin_anew, taper, terminal_voltage
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings, SupervisionLimits
from adaptdrive.control.supervision import monitor, redesign, setpoints, supervisor
from adaptdrive.control.supervision.state import SlowState
from adaptdrive.control.vectors import Vector

# The load loop's control law, on a history that every law shares.


def control_law(gains: Vector, inputs: Vector, outputs: Vector, reference: float) -> float:
    """u[k] before limits.

    Args:
        gains: r_1 ... r_n, s_0 ... s_m.
        inputs: u[k-1] ... u[k-n], as applied.
        outputs: y[k] ... y[k-m].
        reference: r'[k].
    """
    result = 0.0
    for i in range(len(inputs)):
        result -= gains[i] * inputs[i]
    for j in range(len(outputs)):
        result += gains[len(inputs) + j] * (reference - outputs[j])
    return result


def lead_reference(reference: float, last_reference: float, lead: float) -> float:
    """r'[k].

    Args:
        reference: r[k].
        last_reference: r[k-1].
        lead: d, delay of the loop in slow periods; 0 for none.
    """
    return reference + lead * (reference - last_reference)


# The slow half of the controller: one call per slow period T_k.

_RETUNE = math.sqrt(thresholds.NOISE_FLOOR)
"""Relative drift of the slow period from which the fixed gains are made again: less moves the
output by less than the least noise."""


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
    _note_applied(state, sample)
    _take_sample(settings, load, state, sample)
    supervision = settings.supervision
    _design_fixed(settings, load, state, sample)
    redesign.adapt(settings, load, state, sample)
    governed = _governed_reference(load, state, sample)
    reference = setpoints.probe(settings.probing, load, state, sample, governed)
    _look_at_loop(settings, load, state, sample, reference)
    lead = pole_placement.reference_lead(settings, load)
    led = lead_reference(reference, state.reference, lead)
    planned = _look_ahead(settings, load, state, sample, reference, lead)
    state.reference = reference
    if sample.manual:
        return _follow_hand(state, sample)
    return _act(supervision, state, sample, led, planned, _highest(load, state, sample, reference))


def _look_ahead(
    settings: ControllerSettings,
    load: Load,
    state: SlowState,
    sample: SlowSample,
    reference: float,
    lead: float,
) -> float:
    """Return m[k] of the preview, NaN for that of the law.

    There is none without knowledge of what comes, without the adaptive law alone in force, while
    the present estimate is refused (its samples contradict the model that would look ahead), with
    the paper's design, and with a battery, whose set-point is a limit.

    Args:
        settings: The design, and the limits of the law.
        load: The load.
        state: What is known; its preview is overwritten.
        sample: What is asked for.
        reference: r[k].
        lead: d.
    """
    alone = state.blend >= 1.0 and sample.adaptive and load.charging is None
    known = len(sample.upcoming) > 0 and state.supervisor.verdict == supervisor.Verdict.TRUSTED
    if not (known and alone and settings.exact):
        rest(state.reference_filter)
        return math.nan
    references = led_references(reference, state.reference, sample.upcoming, lead)
    return plan(
        state.reference_filter,
        state.trusted_a,
        state.trusted_b,
        references,
        state.sent,
        not state.saturated,
        sample.pole,
        sample.low,
        sample.high,
        settings.supervision.confidence * state.input_noise,
    )


def _note_applied(state: SlowState, sample: SlowSample) -> None:
    """Correct the last input of the history where the law in force has not decided it."""
    decided = state.inputs[0]
    if not sample.followed and math.isfinite(sample.applied):
        state.inputs[0] = state.sent = sample.applied
        state.saturated = True
    elif math.isfinite(sample.held):
        state.inputs[0] = state.sent = sample.held
        state.saturated = sample.held <= sample.low or sample.held >= sample.high
    _condition(state, state.inputs[0] - decided)


def _condition(state: SlowState, shortage: float) -> None:
    """Let the reference filter continue from an input that is short of what its law decided."""
    if state.blend >= 1.0:
        gain = vectors.total(state.adaptive_gains[len(state.inputs) :])
        condition_reference(state.reference_filter, shortage, gain)


def _follow_hand(state: SlowState, sample: SlowSample) -> float:
    """Keep the operator's input in the history of both laws, so that either can take over.

    The course is the one of the output, so that the fast law asks for no other one at once.
    """
    state.adaptive, state.blend, state.handover_step = False, 0.0, math.nan
    state.sent = sample.held
    vectors.shift_in(state.inputs, sample.held)
    vectors.shift_in(state.reference_filter.course, sample.output)
    return sample.held


def _take_sample(
    settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample
) -> None:
    learning, estimator = settings.learning, state.estimator
    estimator.sample.time_s += sample.period_s
    charged = sample.output / learning.output_scale * sample.period_s
    estimator.charge += charged / learning.tau_lambda_s
    estimator.sample.rounding = sample.rounding / learning.output_scale
    estimator.method.fill_regressor(
        estimator, learning, load, sample, (state.outputs, state.inputs)
    )
    moved = abs(sample.output - state.outputs[0]) >= learning.dead_band
    usable = moved and sample.held_share <= thresholds.LOST_SHARE
    update_estimate(estimator, learning, load, sample.output, usable)
    if estimator.method.physical:
        learnt = estimator.sample
        fixed = learnt.target - predict(state.nominal_theta, learnt.regressor)
        own = uncertainty.own_residual(estimator, learning)
        supervisor.compare_residuals(state.supervisor, own, fixed)
    vectors.shift_in(state.outputs, sample.output)


def _design_fixed(
    settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample
) -> None:
    drifted = vectors.exceeds(abs(sample.period_s - state.period_s), _RETUNE * sample.period_s)
    if not drifted and sample.pole == state.pole:
        return
    numerator, denominator = list(load.numerator), list(load.denominator)
    a, b = pole_placement.discrete_model(settings, load, numerator, denominator, sample.period_s)
    vectors.copy_into(
        state.fixed_gains, pole_placement.compensator_gains(a, b, load.order, sample.pole)
    )
    state.period_s, state.pole = sample.period_s, sample.pole


def _governed_reference(load: Load, state: SlowState, sample: SlowSample) -> float:
    """The reference, lowered where the load must be spared; the output where it is led by hand."""
    charging = load.charging
    state.charge.lasted_s += sample.period_s
    if sample.manual:
        begin_anew(state.charge, sample.output)
        return sample.output
    if charging is None:
        return sample.reference
    terminal_V = terminal_voltage(charging, sample.input_filtered[0], sample.output)
    return taper(charging, state.charge, sample.reference, terminal_V, sample.output)


def _look_at_loop(
    settings: ControllerSettings,
    load: Load,
    state: SlowState,
    sample: SlowSample,
    reference: float,
) -> None:
    """Return to the fixed controller, and stay there, when the loop is in trouble."""
    supervision, watch, saturated = settings.supervision, state.watch, state.saturated
    error = reference - sample.output
    strayed = _expected_output(state, sample, reference) - sample.output
    distance = setpoints.distance_from_rest(settings.learning, load, state, sample.output)
    reason = monitor.monitor_loop(
        watch, supervision, error, strayed, distance, sample.pole, sample.held_share, saturated
    )
    monitor.latch_fallback(watch, reason, sample.adaptive)
    _look_for_cycle(supervision, state, sample)
    if load.charging is not None and state.sent < sample.high:
        saturated = False  # below its own voltage a battery answers no input
    expected = load.gain * state.sent
    lag_periods = load.lag_s / sample.period_s
    output = sample.output
    state.unresponsive = monitor.monitor_response(
        watch, supervision, expected, lag_periods, output, saturated
    )


def _look_for_cycle(supervision: SupervisionLimits, state: SlowState, sample: SlowSample) -> None:
    """Look for a limit cycle under the fixed controller."""
    span = sample.high - sample.low
    position = (state.sent - sample.low) / span if span > 0.0 else 0.5
    better = supervisor.moves_better_than_nominal(state.supervisor)
    fixed = not (state.adaptive or sample.manual)
    reference = sample.reference + state.probe.shift
    state.cycling = monitor.monitor_limit_cycle(
        state.cycles, position, reference, supervision.swing_min, better, fixed
    )


def _expected_output(state: SlowState, sample: SlowSample, reference: float) -> float:
    """Return the response that was asked for: 2m equal poles, from y by hand, and the preview."""
    value = reference
    for i in range(len(state.expected)):
        state.expected[i] += (1.0 - sample.pole) * (value - state.expected[i])
        if sample.manual:
            state.expected[i] = sample.output
        value = state.expected[i]
    return value + state.reference_filter.moved


def _highest(load: Load, state: SlowState, sample: SlowSample, reference: float) -> float:
    """Return the highest input of this slow period.

    Below its EMF a battery answers no input, and the laws raise it by more in each period. One
    period therefore raises it by no more than what lets the set-point, or the end current where
    that is larger, flow at once.
    """
    charging = load.charging
    if charging is None:
        return sample.high
    admittance_S = load.numerator[0] / load.denominator[0]
    current_A = max(reference, charging.end_current_A)
    return min(sample.high, state.inputs[0] + current_A / admittance_S)


def _act(
    supervision: SupervisionLimits,
    state: SlowState,
    sample: SlowSample,
    reference: float,
    planned: float,
    highest: float,
) -> float:
    """Both laws on the shared history; what is sent is limited and remembered."""
    sound = state.supervisor.trusted and state.watch.fallback == monitor.Fallback.NONE
    state.adaptive = sample.adaptive and sound
    fixed = control_law(state.fixed_gains, state.inputs, state.outputs, reference)
    filtered = filter_reference(state.reference_filter, reference, planned)
    quiet = control_law(state.adaptive_gains, state.inputs, state.outputs, filtered)
    other = _fast_law(state, quiet)
    ready = vectors.total(state.adaptive_gains) != 0.0
    step = fixed - other if state.adaptive else other - fixed
    state.handover_step = step if ready else math.nan
    wanted = _blended(supervision, state, fixed, other)
    if not math.isfinite(wanted):
        wanted = state.sent
    limited = min(max(wanted, sample.low), highest)
    state.saturated, state.sent = limited != wanted, limited
    _remember(supervision, state, wanted, quiet, sample.low, highest)
    return limited


def _fast_law(state: SlowState, quiet: float) -> float:
    """Return u[k] of the fast adaptive law, before limits; the quiet one before a design."""
    if vectors.total(state.fast_loop) == 0.0:
        return quiet
    filtered = reference_of(state.fast_loop, state.reference_filter.course)
    return control_law(state.fast_gains, state.inputs, state.outputs, filtered)


def _remember(
    supervision: SupervisionLimits,
    state: SlowState,
    wanted: float,
    quiet: float,
    lowest: float,
    highest: float,
) -> None:
    """Take the input into the history of both laws, limited.

    Noise that a limit cuts off on one side would move the mean of the input, and the loop would
    keep that as an error. What noise may ask for beyond a limit is therefore remembered as asked.
    The course gives way to a limit that the response to the reference needs, as the quiet law has
    it, not to one that a correction needs.
    """
    share = supervision.confidence if state.blend >= 1.0 else 0.0
    beyond = share * state.input_noise
    _condition(state, min(max(quiet, lowest - beyond), highest + beyond) - quiet)
    beyond = share * max(state.input_noise, state.fast_noise)
    vectors.shift_in(state.inputs, min(max(wanted, lowest - beyond), highest + beyond))


def _blended(supervision: SupervisionLimits, state: SlowState, fixed: float, other: float) -> float:
    """From one law to the other over some periods, so that even with an error nothing jumps."""
    share = 1.0 / supervision.blend_periods
    if state.adaptive:
        state.blend = min(1.0, state.blend + share)
    else:
        state.blend = max(0.0, state.blend - share)
    if state.blend <= 0.0:
        return fixed
    if state.blend >= 1.0:
        return other
    return fixed + state.blend * (other - fixed)
