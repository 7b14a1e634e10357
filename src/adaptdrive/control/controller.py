"""The whole two-rate controller: one object, `tick(measurement, order)` gives a command.

At tick n = kQ the fast half leaves a `Snapshot`; the slow half makes a `Decision` of it; whoever
runs the controller applies that decision right before the tick at which it takes effect. The same
calls in the same order give the same commands bit for bit, live, simulated and replayed.
"""

import math
from dataclasses import replace
from typing import Final

from adaptdrive.control import fast, signals, slow
from adaptdrive.control.design.reference import AHEAD
from adaptdrive.control.estimation import filters
from adaptdrive.control.estimation.change import WORDS
from adaptdrive.control.estimation.direct import METHODS
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.loads import battery
from adaptdrive.control.loads.load import Charging, Load, to_input, to_voltage
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Measurement, Order, Snapshot
from adaptdrive.control.supervision import monitor, setpoints
from adaptdrive.control.supervision.state import SlowState, reason

_UNRESPONSIVE: Final = (
    "no-response",
    "no response: input at its limit for long, and the output has not moved",
)
"""Kind and text of a trip, as of those that follow."""

_DISCONNECTED: Final = (
    "no-current",
    "no current: the current has left in one step: is the battery disconnected?",
)
_TOO_LONG = (
    "charge time: the charge has not ended within load.charge.longest_h = {:g} h: does the "
    "current sensor read too high?"
)
_CYCLING: Final = (
    "limit-cycle",
    "limit cycle: the fixed controller drives V_c from limit to limit",
)

# found at once by compiled code
_OFF: Final[signals.Stage] = signals.Stage.OFF
_RUN: Final[signals.Stage] = signals.Stage.RUN
_MANUAL: Final[signals.Mode] = signals.Mode.MANUAL
_ADAPTIVE: Final[signals.Mode] = signals.Mode.ADAPTIVE


class Controller:
    """Both halves of the controller of one drive and one load.

    Attributes:
        settings: Designs, rates and rules.
        load: The load and its nominal model.
        trusted: Physical parameters from which the next run starts; None before there are any.
        state: State of the slow half.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        load: Load,
        prior: tuple[float, ...] | None = None,
        resolution: float = 0.0,
    ) -> None:
        """Build a controller at rest.

        Args:
            settings: Designs, rates and rules.
            load: The load and its nominal model.
            prior: Physical parameters that an earlier run had trusted, in the order of
                `Load.names`: each run starts from them, or from those that took effect last. A
                method whose θ is not physical ignores them.
            resolution: Step of the output that an earlier run has found in its samples, 0 for none.
        """
        self.trusted = prior if METHODS[settings.learning.method].physical else None
        self.settings = settings
        self.load = load
        self._stage = signals.Stage.OFF
        self._fast = fast.FastState(tick=0, boost_reference_V=0.0, error_sum=0.0)
        self._bank = self._new_bank(settings.rates.nominal_tick_s, 0.0, 0.0)
        self._bank.quantiser = filters.known_quantiser(resolution)
        self.state = SlowState(settings, load, 0.0, 0.0)
        self._reach = setpoints.nominal_reach(load, settings.stage)
        self._snapshot: Snapshot | None = None

    def tick(self, measurement: Measurement, order: Order) -> signals.Command:
        """Run the fast half for one half line cycle.

        Args:
            measurement: Values of the drive and its sensors; they must be finite.
            order: What is asked for.

        Returns:
            Command to the drive.
        """
        if order.stage is not self._stage:
            self._enter(order.stage, measurement)
        if order.stage is _OFF:
            return signals.SAFE_COMMAND
        if order.stage is _RUN:
            if order.mode is _MANUAL:  # a battery's terminals stay at their limit
                highest_V = self._bearable(measurement, 1.0)
                fast.set_by_hand(self._fast, self.settings.stage, order.manual_V, highest_V)
            if fast.take_in(self.settings, self.load, self._fast, self._bank, measurement):
                self._snapshot = self._take(measurement, order)
        highest_V = self._bearable(measurement, battery.ABOVE)
        scale_S, reference_V = fast.drive(self._fast, self.settings.stage, measurement, highest_V)
        bridge = order.stage is _RUN or self.settings.stage.boost_needs_bridge
        return signals.Command(scale_S, reference_V, bridge)

    def take_snapshot(self) -> Snapshot | None:
        """The snapshot made in the last tick, if any; only once."""
        snapshot, self._snapshot = self._snapshot, None
        return snapshot

    def decide(self, snapshot: Snapshot) -> signals.Decision:
        """Run the slow half on a snapshot."""
        state, settings, charging = self.state, self.settings, self.load.charging
        load_input = slow.slow_step(settings, self.load, state, self._sample(snapshot))
        voltage = to_voltage(load_input, self.load.input_gain, self.load.input_exponent)
        trusted = state.accepted and state.watch.fallback == monitor.Fallback.NONE
        kept = trusted and settings.exact and state.estimator.physical
        self._note_reach()
        fault_kind, fault = _fault(state, charging)
        mode, gains = signals.Mode.FIXED, state.fixed_gains
        if state.adaptive and state.law is not None:
            mode, gains = _ADAPTIVE, state.law.quiet_gains
        return signals.Decision(
            k=snapshot.k,
            boost_reference_V=voltage,
            controller=_MANUAL if snapshot.order.mode is _MANUAL else mode,
            accepted=state.accepted,
            reason=reason(
                state, settings.supervision, settings.probing, self.load, snapshot.order.mode
            ),
            estimates=self._estimates(),
            gains=(*gains, sum(gains[len(state.inputs) :])),
            innovation=state.estimator.innovation,
            excitation=state.estimator.excitation,
            handover_step_V=state.handover_step,
            pole=snapshot.order.pole,
            fault=fault,
            fault_kind=fault_kind,
            complete=charging is not None and battery.is_complete(charging, state.charge),
            reach_low=self._reach.low,
            reach_high=self._reach.high,
            probe=state.probe.shift if state.probe.age_periods > 0 else math.nan,
            response_spread=state.spread if state.accepted else math.nan,
            change=WORDS[state.estimator.decided],
            trusted=tuple(state.values) if kept else None,
        )

    def _note_reach(self) -> None:
        """Note what V_c can do: by an estimate that is trusted now, by the nominal model else.

        While the last trusted gains wait for a better estimate, what was known last stays.
        """
        settings, load, state = self.settings, self.load, self.state
        if state.accepted:
            self._reach = setpoints.estimated_reach(load, settings.stage, state)
        elif not state.supervisor.trusted:
            self._reach = setpoints.nominal_reach(load, settings.stage)

    @property
    def resolution(self) -> float:
        """The step of the output that was found in its samples; 0 while none is known."""
        return self._bank.quantiser.step

    def apply(self, decision: signals.Decision) -> None:
        """Let a decision take effect from the next tick on.

        V_c stays where the operator has set it since: the decision is older. The next run starts
        from estimates that took effect: a record shows these, so that a replay keeps the same.
        """
        if self._stage is not _RUN:
            return
        if decision.controller is not _MANUAL and not self._fast.by_hand:
            self._fast.boost_reference_V = decision.boost_reference_V
        if decision.trusted is not None:
            self.trusted = decision.trusted

    def _enter(self, stage: signals.Stage, measurement: Measurement) -> None:
        """Start a stage from what is measured now, so that it begins without a bump."""
        limits, begun = self.settings.stage, stage is _RUN
        held_V = rest_V = measurement.boost_voltage_V
        if begun and self._stage is signals.Stage.PRECHARGE:
            held_V, rest_V = self._unfed(measurement.output, held_V)
        reference_V = min(max(held_V, limits.boost_reference_min_V), limits.boost_reference_max_V)
        if stage is signals.Stage.PRECHARGE:
            reference_V = max(limits.boost_reference_min_V, 0.0)
        self._stage, self._snapshot = stage, None
        self._fast = fast.FastState(
            tick=measurement.tick,
            boost_reference_V=reference_V,
            error_sum=fast.initial_sum(held_V),
        )
        if begun:
            self._begin_run(measurement, held_V, rest_V)

    def _begin_run(self, measurement: Measurement, held_V: float, rest_V: float) -> None:
        """Forget the run before, but not what it has learnt of sensor and load.

        Args:
            measurement: Of this tick.
            held_V: The voltage from which V_c begins.
            rest_V: What the λ filters are to remember.
        """
        load, output, quantiser = self.load, measurement.output, self._bank.quantiser
        self._bank = self._new_bank(measurement.tick_period_s, output, rest_V)
        self._bank.quantiser = quantiser
        if self.trusted is not None:
            self.settings = _recalling(self.settings)
        first_V = held_V if load.charging is None else rest_V
        self.state = state = SlowState(self.settings, load, output, first_V)
        # v_bst may hold the load at another output than this: the other lag of the response
        # watch begins there, so that a load which rests where it is need not move
        state.watch.slow = load.gain * self._to_input(measurement.boost_voltage_V)
        self._reach = setpoints.nominal_reach(load, self.settings.stage)
        if self.trusted is not None and isinstance(state.estimator, LambdaEstimator):
            state.estimator.start_from(list(self.trusted))
            state.recalled = True

    def _unfed(self, output: float, voltage_V: float) -> tuple[float, float]:
        """Return where V_c and the memory of the λ filters begin, with a load that was not fed.

        V_c begins at the measured voltage, at most at the one at which the load would rest at
        this output. The capacitor may still be full from the run before: holding it would move a
        load, and charge a battery at any current. The λ filters must not remember the voltage
        that was kept from the load. A battery rests at its own EMF, whatever that is; there the
        measured one is kept.
        """
        load, floor_V = self.load, self.settings.stage.boost_reference_min_V
        if load.charging is not None:
            return floor_V, voltage_V
        load_input = output * load.denominator[-1] / load.numerator[-1]
        rest_V = max(0.0, to_voltage(load_input, load.input_gain, load.input_exponent))
        return min(voltage_V, max(rest_V, floor_V)), rest_V

    def _new_bank(self, tick_period_s: float, output: float, voltage: float) -> fast.FilterBank:
        tau = self.settings.learning.tau_lambda_s
        return fast.new_filter_bank(self.load, tick_period_s, tau, output, voltage)

    def _take(self, measurement: Measurement, order: Order) -> Snapshot:
        rates, order_m = self.settings.rates, self.load.order
        held_V = self._fast.boost_reference_V if self._fast.by_hand else math.nan
        means = fast.take_means(self._bank)
        applied_V, followed, held = fast.close_period(self._fast, self.settings)
        resolution, rounding = fast.take_rounding(self.settings, self._bank)
        tick_s, tau_s = measurement.tick_period_s, self.settings.learning.tau_lambda_s
        self._bank.gains = filters.chain_gains(order_m, tick_s, tau_s)
        return Snapshot(
            k=measurement.tick // rates.ticks_per_period,
            tick=measurement.tick,
            period_s=rates.ticks_per_period * measurement.tick_period_s,
            order=order,
            output=means[0],
            output_filtered=tuple(means[1 : order_m + 1]),
            input_filtered=tuple(means[order_m + 1 :]),
            applied_V=applied_V,
            followed=followed,
            held_ticks=held,
            held_V=held_V,
            resolution=resolution,
            rounding=rounding,
            upcoming=self._upcoming(measurement.tick, order.moving),
        )

    def _upcoming(self, tick: int, known: signals.MovingReference | None) -> tuple[float, ...]:
        """Return the set-points of the slow periods to come, none where they are not known."""
        if known is None:
            return ()
        rates = self.settings.rates
        ticks = [tick + i * rates.ticks_per_period for i in range(1, AHEAD)]
        return tuple([known.value(later, rates.nominal_tick_s) for later in ticks])

    def _bearable(self, measurement: Measurement, share: float) -> float:
        """Return the V_c for a share of the voltage of a battery; infinite for other loads."""
        charging, voltage_V = self.load.charging, measurement.boost_voltage_V
        if charging is None:
            return math.inf
        power_W = measurement.load_power_W
        current_A = battery.proven_current(charging, measurement.output, voltage_V, power_W)
        return battery.boost_voltage(charging, share, current_A)

    def _sample(self, snapshot: Snapshot) -> signals.SlowSample:
        stage = self.settings.stage
        return signals.SlowSample(
            period_s=snapshot.period_s,
            output=snapshot.output,
            output_filtered=list(snapshot.output_filtered),
            input_filtered=list(snapshot.input_filtered),
            applied=self._to_input(snapshot.applied_V),
            followed=snapshot.followed,
            held_share=snapshot.held_ticks / self.settings.rates.ticks_per_period,
            reference=snapshot.order.reference,
            adaptive=snapshot.order.mode is _ADAPTIVE,
            pole=snapshot.order.pole,
            low=self._to_input(stage.boost_reference_min_V),
            high=self._to_input(stage.boost_reference_max_V),
            manual=snapshot.order.mode is _MANUAL,
            held=self._to_input(snapshot.held_V),
            steady=snapshot.order.steady,
            lowest=self._reach.low,
            highest=self._reach.high,
            rounding=snapshot.rounding,
            upcoming=list(snapshot.upcoming),
        )

    def _to_input(self, voltage_V: float) -> float:
        return to_input(voltage_V, self.load.input_gain, self.load.input_exponent)

    def _estimates(self) -> dict[str, signals.Estimate]:
        state, load, learning = self.state, self.load, self.settings.learning
        deviations = [math.nan] * len(load.names)
        if math.isfinite(state.values[0]):
            deviations = state.estimator.shown_deviations(state.values)
        estimates = {
            name: signals.Estimate(value, deviation)
            for name, value, deviation in zip(load.names, state.values, deviations, strict=True)
        }
        if learning.bias:
            own = state.estimator
            deviation = own.offset_deviation() if math.isfinite(deviations[0]) else math.nan
            estimates["input_offset"] = signals.Estimate(own.input_offset(), deviation)
        return estimates


def _recalling(settings: ControllerSettings) -> ControllerSettings:
    """With a prior no warm-up is needed: its gains act at once."""
    periods = min(settings.learning.settle_periods, settings.supervision.warm_up_periods)
    return replace(settings, supervision=replace(settings.supervision, warm_up_periods=periods))


def _fault(state: SlowState, charging: Charging | None) -> tuple[str, str]:
    """Return kind and text of the trip that the load needs, both empty for none."""
    if state.unresponsive:
        return _UNRESPONSIVE
    if charging is not None and battery.is_disconnected(charging, state.charge):
        return _DISCONNECTED
    if charging is not None and battery.is_too_long(charging, state.charge):
        return "charge-too-long", _TOO_LONG.format(charging.longest_s / 3600.0)
    return _CYCLING if state.cycling else ("", "")
