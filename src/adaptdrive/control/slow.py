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
from adaptdrive.control.design.pole_placement import Plant, discrete_model, reference_lead
from adaptdrive.control.design.reference import (
    condition_reference,
    filter_reference,
    lead_reference,
    led_references,
    plan,
    reference_of,
    rest,
)
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.loads.battery import begin_anew, taper, terminal_voltage
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings, SupervisionLimits
from adaptdrive.control.signals import SlowSample
from adaptdrive.control.supervision import monitor, redesign, setpoints
from adaptdrive.control.supervision.state import SlowState
from adaptdrive.control.supervision.supervisor import Verdict
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
    _take_sample(state, sample)
    supervision = settings.supervision
    _design_fixed(settings, load, state, sample)
    redesign.adapt(settings, load, state, sample)
    governed = _governed_reference(load, state, sample)
    reference = setpoints.probe(settings.probing, load, state, sample, governed)
    _look_at_loop(load, state, sample, reference)
    lead = reference_lead(settings, load)
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
    law, alone = state.law, state.blend >= 1.0 and sample.adaptive and load.charging is None
    known = len(sample.upcoming) > 0 and state.supervisor.verdict == Verdict.TRUSTED
    if law is None or not (known and alone and settings.exact):
        rest(state.reference_filter)
        return math.nan
    return plan(
        state.reference_filter,
        law.plant,
        led_references(reference, state.reference, sample.upcoming, lead),
        state.sent,
        free=not state.saturated,
        pole=sample.pole,
        low=sample.low,
        high=sample.high,
        beyond=settings.supervision.confidence * law.quiet_noise,
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
    if state.blend >= 1.0 and state.law is not None:
        gain = vectors.total(state.law.quiet_gains[len(state.inputs) :])
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


def _take_sample(state: SlowState, sample: SlowSample) -> None:
    estimator = state.estimator
    usable = sample.held_share <= thresholds.LOST_SHARE
    estimator.take_sample(sample, state.outputs, state.inputs, usable=usable)
    if isinstance(estimator, LambdaEstimator):
        fixed = estimator.nominal_innovation()
        state.supervisor.compare_residuals(estimator.residual(), fixed)
    vectors.shift_in(state.outputs, sample.output)


def _design_fixed(
    settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample
) -> None:
    drifted = vectors.exceeds(abs(sample.period_s - state.period_s), _RETUNE * sample.period_s)
    if not drifted and sample.pole == state.pole:
        return
    numerator, denominator = list(load.numerator), list(load.denominator)
    plant = Plant(*discrete_model(settings, load, numerator, denominator, sample.period_s))
    state.fixed_gains = plant.gains(plant.asked(sample.pole))
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


def _look_at_loop(load: Load, state: SlowState, sample: SlowSample, reference: float) -> None:
    """Return to the fixed controller, and stay there, when the loop is in trouble."""
    watch, output, saturated = state.watch, sample.output, state.saturated
    watch.check(
        error=reference - output,
        strayed=_expected_output(state, sample, reference) - output,
        rest_distance=setpoints.distance_from_rest(load, state, output),
        pole=sample.pole,
        held_share=sample.held_share,
        saturated=saturated,
        asked=sample.adaptive,
    )
    span = sample.high - sample.low
    state.cycling = state.cycles.check(
        position=(state.sent - sample.low) / span if span > 0.0 else 0.5,
        reference=sample.reference + state.probe.shift,
        better=state.supervisor.moves_better_than_nominal(),
        fixed=not (state.adaptive or sample.manual),
    )
    if load.charging is not None and state.sent < sample.high:
        saturated = False  # below its own voltage a battery answers no input
    expected, lag_periods = load.gain * state.sent, load.lag_s / sample.period_s
    state.unresponsive = watch.check_response(expected, lag_periods, output, saturated)


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
    law, inputs, outputs = state.law, state.inputs, state.outputs
    sound = state.supervisor.trusted and state.watch.fallback == monitor.Fallback.NONE
    state.adaptive = sample.adaptive and sound and law is not None
    fixed = control_law(state.fixed_gains, inputs, outputs, reference)
    filtered = filter_reference(state.reference_filter, reference, planned)
    quiet = other = fixed
    if law is not None:
        quiet = control_law(law.quiet_gains, inputs, outputs, filtered)
        filtered = reference_of(law.fast_loop, state.reference_filter.course)
        other = control_law(law.fast_gains, inputs, outputs, filtered)
    step = fixed - other if state.adaptive else other - fixed
    state.handover_step = step if law is not None else math.nan
    wanted = _blended(supervision, state, fixed, other)
    if not math.isfinite(wanted):
        wanted = state.sent
    limited = min(max(wanted, sample.low), highest)
    state.saturated, state.sent = limited != wanted, limited
    _remember(supervision, state, wanted, quiet, sample.low, highest)
    return limited


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
    law, beyond = state.law, 0.0
    if law is not None and state.blend >= 1.0:
        beyond = supervision.confidence * law.quiet_noise
        _condition(state, min(max(quiet, lowest - beyond), highest + beyond) - quiet)
        beyond = max(beyond, supervision.confidence * law.fast_noise)
    vectors.shift_in(state.inputs, min(max(wanted, lowest - beyond), highest + beyond))


def _blended(supervision: SupervisionLimits, state: SlowState, fixed: float, other: float) -> float:
    """From one law to the other over some periods, so that even with an error nothing jumps."""
    share = 1.0 / supervision.blend_periods
    state.blend = min(max(0.0, state.blend + (share if state.adaptive else -share)), 1.0)
    if state.blend in {0.0, 1.0}:  # no rounding, and no law that is not in force
        return other if state.blend else fixed
    return fixed + state.blend * (other - fixed)
