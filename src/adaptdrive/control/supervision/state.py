"""State of the slow half between periods, and its reasons for operators."""

import math
from dataclasses import dataclass

from adaptdrive.control import signals, thresholds
from adaptdrive.control.design import pole_placement
from adaptdrive.control.design.noise import Law
from adaptdrive.control.design.reference import ReferenceFilter
from adaptdrive.control.estimation.direct import new_estimator
from adaptdrive.control.loads.battery import ChargeState
from adaptdrive.control.loads.load import Load, to_input
from adaptdrive.control.settings import ControllerSettings, Probing, SupervisionLimits
from adaptdrive.control.supervision.monitor import (
    FAR_BETTER,
    CycleMonitor,
    Fallback,
    LoopMonitor,
)
from adaptdrive.control.supervision.supervisor import Supervisor, Verdict

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


class SlowState:
    """State of the slow half between periods.

    Attributes:
        inputs: u[k-1] ... u[k-n] as applied; where a limit cuts noise off, with it.
        outputs: y[k] ... y[k-m].
        fixed_gains: Gains for the nominal model.
        pole: Pole that the fixed gains were designed for.
        period_s: Period that they were designed for.
        estimator: The estimator.
        values: Estimated physical parameters.
        recalled: Whether the estimate is what a run before this one had trusted.
        supervisor: The supervisor.
        accepted: Whether the estimate of this period went live.
        spread: How far the response may be off within the covariance, as a share of a step.
        law: The adaptive law, made of the last trusted estimate; None before the first.
        reference: r[k-1].
        reference_filter: Reference filter of the adaptive law, and its preview.
        adaptive: Whether the adaptive law is in force.
        blend: Share of the adaptive law in what is sent, 0 to 1.
        handover_step: Law not in force minus law in force.
        sent: The input in force, within its limits.
        saturated: Whether the last input was at a limit or could not be followed.
        expected: Response to the reference that was asked for, a lag for each pole.
        watch: The watch over the adaptive law.
        unresponsive: Whether the load has stopped to answer.
        cycles: The watch over the fixed law.
        cycling: Whether the fixed law is in a limit cycle.
        charge: The charger of a battery.
        probe: The probing.
    """

    def __init__(
        self, settings: ControllerSettings, load: Load, output: float, boost_voltage_V: float
    ) -> None:
        """Begin at rest: the present output and voltage have been there for ever.

        Args:
            settings: Designs, rates and rules.
            load: The load and its nominal model.
            output: y.
            boost_voltage_V: v_bst.
        """
        taps = pole_placement.past_inputs(settings, load)
        load_input = to_input(boost_voltage_V, load.input_gain, load.input_exponent)
        nominal = load.physical(list(load.numerator), list(load.denominator))
        # the EMF of a battery is not in its model
        resting = output if load.charging is None else load_input * load.gain
        self.inputs = [load_input] * taps
        self.outputs = [output] * (load.order + 1)
        self.fixed_gains = [0.0] * (taps + load.order + 1)
        self.pole = self.period_s = math.nan
        self.estimator = new_estimator(settings.learning, load, taps)
        self.values = [math.nan] * len(nominal)
        self.recalled = False
        self.supervisor = Supervisor(settings.supervision, nominal)
        self.accepted = False
        self.spread = math.nan
        self.law: Law | None = None
        self.reference = output
        self.reference_filter = ReferenceFilter(load.order, taps)
        self.adaptive = False
        self.blend = 0.0
        self.handover_step = math.nan
        self.sent = load_input
        self.saturated = False
        self.expected = [output] * (2 * load.order)
        self.watch = LoopMonitor(settings.supervision, resting)
        self.unresponsive = False
        self.cycles = CycleMonitor(settings.supervision.swing_min)
        self.cycling = False
        self.charge = ChargeState(max(0.0, output))
        self.probe = ProbeState()


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
    index = max(0, state.supervisor.out_of_bounds(state.values))
    nominal = state.supervisor.nominal[index]
    low, high = supervision.ratio_min * nominal, supervision.ratio_max * nominal
    name, value = load.names[index], state.values[index]
    text = f"estimate {name} = {value:.4g} outside {low:.4g}…{high:.4g}"
    better = state.supervisor.better_than_nominal()
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
