"""Set-points: which the load can reach, and small steps of them that show the load.

A set-point at the edge of what the drive can do leaves the input at its limit for ever. That is no
trouble while the output rests where a model puts it,

    y = g (u + d)              d: the estimated offset of the input, a load torque for example

and a load that is on its way there is none either.

y = g (u + d)       u: the input at either limit of V_c, d: the estimated offset of the input

A load that stores nothing below its own voltage, a battery, has no negative output; where its EMF
is not known yet, the range is not known either.

At rest any dynamics predict the same output. A load that has changed there goes unnoticed until the
set-point is moved next, and then responds as the old gains let it. Where that is switched on, the
set-point is moved by a small share of its range, to either side in turn:

    r + A, r, r - A, r, ...         each for twice the delay of the response that is asked for

only while adaptive is asked for and the output rests on a constant set-point, and only within what
V_c can hold: where there is no room on one side, to the other. A charger never asks for more than
was asked for: its current gets a ripple of a share of itself, downwards, each level for the time
constant of the nominal battery, and none while the voltage limit lowers it. A probe ends when the
load is known, and at once when the operator asks for anything else, the input reaches a limit, or
the fixed controller has taken over for good. It never lasts longer than five excursions, and
`stale_periods` must pass before the next one.
"""

import math

from adaptdrive.control.loads.load import Load, to_input
from adaptdrive.control.settings import PowerStage, Probing
from adaptdrive.control.signals import UNKNOWN, Reach, SlowSample
from adaptdrive.control.supervision import monitor, supervisor
from adaptdrive.control.supervision.state import ProbeState, SlowState
from adaptdrive.control.thresholds import FEWEST

# Steady state of the load at a constant input, by the nominal and by the trusted model.


def distance_from_rest(load: Load, state: SlowState, output: float) -> float:
    """Return how far the output is from the nearest place where a model rests at this input.

    Args:
        load: The nominal model.
        state: The input in force, the last trusted model, and the estimate.
        output: y[k].
    """
    offset = estimated_offset(state)
    distance = _distance(load, load.gain, state.sent, offset, output)
    if state.supervisor.trusted and state.law is not None:
        gain = state.law.plant.gain
        distance = min(distance, _distance(load, gain, state.sent, offset, output))
    return distance


def estimated_offset(state: SlowState) -> float:
    """Return the estimated offset of the input, 0 where none is estimated."""
    estimated = state.estimator.input_offset() if state.estimator.physical else 0.0
    return estimated if math.isfinite(estimated) else 0.0


def _distance(load: Load, gain: float, held: float, offset: float, output: float) -> float:
    """Distance from g·u or from g·(u + d), the nearer; a battery takes no negative current."""
    plain, shifted = load.possible(gain * held), load.possible(gain * (held + offset))
    return min(abs(output - plain), abs(output - shifted))


# The outputs that V_c can hold: where a model rests at the lowest and at the highest V_c.


def nominal_reach(load: Load, stage: PowerStage) -> Reach:
    """Return what V_c reaches with the nominal load; not known for a battery, whose EMF is not.

    Args:
        load: The load.
        stage: Limits of V_c.
    """
    if load.charging is not None:
        return UNKNOWN
    return _reach(load, stage, load.gain, 0.0)


def estimated_reach(load: Load, stage: PowerStage, state: SlowState) -> Reach:
    """Return what V_c reaches with the last trusted model and the present offset.

    Args:
        load: The load.
        stage: Limits of V_c.
        state: An estimate that is trusted now.
    """
    gain = state.law.plant.gain if state.law is not None else math.nan
    return _reach(load, stage, gain, estimated_offset(state))


def _reach(load: Load, stage: PowerStage, gain: float, offset: float) -> Reach:
    scale, exponent = load.input_gain, load.input_exponent
    low = gain * (to_input(stage.boost_reference_min_V, scale, exponent) + offset)
    high = gain * (to_input(stage.boost_reference_max_V, scale, exponent) + offset)
    return Reach(_shown(load.possible(low)), _shown(load.possible(high)))


def _shown(value: float) -> float:
    """Return a value as it is shown, with three digits: what is shown is what is accepted."""
    return float(f"{value:.3g}")


# Probing: small steps of a constant set-point that show the load, where it is not known.

HALF_DELAYS = 2.0
"""Time at each level, in delays of the response that is asked for: it has then settled."""

EXCURSIONS = FEWEST
"""Longest probe: a load that the fewest excursions which can show anything do not show is hidden
by noise."""


def half_periods(load: Load, pole: float, period_s: float) -> int:
    """Return the time at each level of an excursion, in slow periods.

    Args:
        load: Its order m; of a battery the time constant too, which the current must last to show.
        pole: Pole that is asked for; the response has 2m of it.
        period_s: T_k.
    """
    half = round(HALF_DELAYS * 2.0 * load.order * pole / (1.0 - pole))
    if load.charging is None:
        return half
    return max(half, round(load.lag_s / period_s))


def probe(
    probing: Probing, load: Load, state: SlowState, sample: SlowSample, reference: float
) -> float:
    """Return the set-point of this slow period: the one asked for, or moved by a probe.

    Args:
        probing: Amplitude and times; an amplitude of 0 returns the set-point as it is.
        load: The load.
        state: What is known; its probe is overwritten.
        sample: What was asked for.
        reference: Set-point, lowered where the load must be spared.
    """
    if not probing.amplitude > 0.0:
        return reference
    own, half = state.probe, half_periods(load, sample.pole, sample.period_s)
    free = _is_free(probing, state, sample, reference)
    amplitude = _amplitude(probing, load, reference)
    _count(own, free, abs(reference - sample.output) <= amplitude)
    if own.age_periods > 0:
        _go_on(probing, own, free, half, _is_known(state, 2 * half))
    elif own.pause_periods == 0 and own.rest_periods > half and is_wanted(probing, state):
        own.age_periods = 1
    own.reference = reference
    own.shift = _shift(probing, load, own, sample, half, amplitude)
    return reference + own.shift


def _amplitude(probing: Probing, load: Load, reference: float) -> float:
    """Return the largest distance from a set-point."""
    return probing.amplitude if load.charging is None else probing.amplitude * reference


def is_wanted(probing: Probing, state: SlowState) -> bool:
    """Return whether the load is not known: an estimate in doubt, or none that is recent.

    Args:
        probing: When information is old.
        state: What is known.
    """
    old = state.estimator.unseen_periods > probing.stale_periods
    return old or supervisor.is_uncertain(state.supervisor.verdict)


def _is_free(probing: Probing, state: SlowState, sample: SlowSample, reference: float) -> bool:
    """Return whether the estimator learns, nobody else moves the set-point or holds the input."""
    asked = sample.adaptive and sample.steady and not sample.manual
    asked = asked and state.estimator.periods >= probing.settle_periods
    same = reference == sample.reference and reference == state.probe.reference
    return asked and same and not state.saturated and state.watch.fallback == monitor.Fallback.NONE


def _is_known(state: SlowState, excursion_periods: int) -> bool:
    """Return whether the last excursion has shown the load, and nothing contests the estimate."""
    estimator = state.estimator
    seen = estimator.unseen_periods < excursion_periods and not estimator.is_contested()
    return seen and state.supervisor.verdict == supervisor.Verdict.TRUSTED


def _count(own: ProbeState, free: bool, near: bool) -> None:
    """Count the periods at rest, and those of the pause."""
    own.rest_periods = own.rest_periods + 1 if free and near and own.age_periods == 0 else 0
    own.pause_periods = max(0, own.pause_periods - 1)


def _go_on(probing: Probing, own: ProbeState, free: bool, half: int, known: bool) -> None:
    """Go on with a probe for one more period, or end it."""
    is_back = own.age_periods % (2 * half) == 0
    spent = own.age_periods >= EXCURSIONS * 2 * half
    if not free or spent or (known and is_back):
        own.age_periods, own.pause_periods = 0, probing.stale_periods
    else:
        own.age_periods += 1


def _shift(
    probing: Probing,
    load: Load,
    own: ProbeState,
    sample: SlowSample,
    half: int,
    amplitude: float,
) -> float:
    """Return how far the set-point is moved in this slow period; 0 where there is no room."""
    if own.age_periods == 0 or (own.age_periods - 1) % (2 * half) >= half:
        return 0.0
    up = load.charging is None and _has_room(probing, sample, own.reference + amplitude)
    down = _has_room(probing, sample, own.reference - amplitude)
    upwards = (own.age_periods - 1) // (2 * half) % 2 == 0
    if up and (upwards or not down):
        return amplitude
    return -amplitude if down else 0.0


def _has_room(probing: Probing, sample: SlowSample, level: float) -> bool:
    """Return whether a level is a set-point that V_c can hold."""
    beyond = level < sample.lowest or level > sample.highest  # neither of a reach not known yet
    return probing.lowest <= level <= probing.highest and not beyond
