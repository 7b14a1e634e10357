"""The whole two-rate controller: one object, `tick(measurement, order)` gives a command.

At tick n = kQ the fast half leaves a `Snapshot`; the slow half makes a `Decision` of it; whoever
runs the controller applies that decision right before the tick at which it takes effect. The same
calls in the same order give the same commands bit for bit, live, simulated and replayed.
"""

import math
from dataclasses import replace
from typing import Final

from adaptdrive.control import fast, signals, slow, voltage_loop
from adaptdrive.control.design.reference import AHEAD
from adaptdrive.control.estimation import estimator, filters, methods, regression
from adaptdrive.control.loads.battery import (
    ABOVE,
    boost_voltage,
    is_complete,
    is_disconnected,
    is_too_long,
    proven_current,
)
from adaptdrive.control.loads.load import Charging, Load, to_input, to_voltage
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Measurement, Order, Snapshot
from adaptdrive.control.supervision import monitor, setpoints
from adaptdrive.control.supervision.state import SlowState, new_slow_state, reason

_UNRESPONSIVE = "no response: input at its limit for long, and the output has not moved"
_DISCONNECTED = "no current: the current has left in one step: is the battery disconnected?"
_TOO_LONG = (
    "charge time: the charge has not ended within load.charge.longest_h = {:g} h: does the "
    "current sensor read too high?"
)
_CYCLING = "limit cycle: the fixed controller drives V_c from limit to limit"

# found at once by compiled code
_OFF: Final[signals.Stage] = signals.Stage.OFF
_RUN: Final[signals.Stage] = signals.Stage.RUN
_MANUAL: Final[signals.Mode] = signals.Mode.MANUAL


class Controller:
    """Both halves of the controller of one drive and one load."""

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
                `Load.names`: each run starts from them, or from those that a run before it had
                trusted. A method whose θ is not physical ignores them.
            resolution: Step of the output that an earlier run has found in its samples, 0 for none.
        """
        self._prior = prior if methods.METHODS[settings.learning.method].physical else None
        self.settings = settings if self._prior is None else _recalling(settings)
        self._trusted: tuple[float, ...] | None = None
        self._proposed: dict[int, tuple[float, ...]] = {}
        self._learnt: tuple[float, ...] | None = None
        self.load = load
        self._stage = signals.Stage.OFF
        self._fast = fast.FastState(tick=0, boost_reference_V=0.0, error_sum=0.0)
        self._bank = self._new_bank(settings.rates.nominal_tick_s, 0.0, 0.0)
        self._bank.quantiser = filters.known_quantiser(resolution)
        self.state = new_slow_state(settings, load, 0.0, 0.0)
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
            if order.mode is _MANUAL:
                self._set_by_hand(measurement, order)
            self._run_filters(measurement, order)
        bridge = order.stage is _RUN or self.settings.stage.boost_needs_bridge
        return self._drive(measurement, bridge)

    def take_snapshot(self) -> Snapshot | None:
        """The snapshot made in the last tick, if any; only once."""
        snapshot, self._snapshot = self._snapshot, None
        return snapshot

    def decide(self, snapshot: Snapshot) -> signals.Decision:
        """Run the slow half on a snapshot."""
        state, settings, charging = self.state, self.settings, self.load.charging
        load_input = slow.slow_step(settings, self.load, state, self._sample(snapshot))
        voltage = to_voltage(load_input, self.load.input_gain, self.load.input_exponent)
        if state.accepted and state.watch.fallback == monitor.Fallback.NONE:
            self._trusted = self._proposed[snapshot.k] = tuple(state.values)
        self._note_reach()
        taps = len(state.inputs)
        gains = state.adaptive_gains if state.adaptive else state.fixed_gains
        return signals.Decision(
            k=snapshot.k,
            boost_reference_V=voltage,
            controller=_in_force(snapshot.order.mode, adaptive=state.adaptive),
            accepted=state.accepted,
            reason=reason(
                state, settings.supervision, settings.probing, self.load, snapshot.order.mode
            ),
            estimates=self._estimates(),
            gains=(*gains, sum(gains[taps:])),
            innovation=state.estimator.innovation,
            excitation=state.estimator.excitation,
            handover_step_V=state.handover_step,
            pole=snapshot.order.pole,
            fault=_fault(state, charging),
            complete=charging is not None and is_complete(charging, state.charge),
            reach_low=self._reach.low,
            reach_high=self._reach.high,
            probe=state.probe.shift if state.probe.age_periods > 0 else math.nan,
            response_spread=state.spread if state.accepted else math.nan,
        )

    def _note_reach(self) -> None:
        """Note what V_c can do: by an estimate that is trusted now, by the nominal model else.

        While the last trusted gains wait for a better estimate, what was known last stays.
        """
        settings, load, state = self.settings, self.load, self.state
        if state.accepted:
            self._reach = setpoints.estimated_reach(settings.learning, load, settings.stage, state)
        elif not state.supervisor.trusted:
            self._reach = setpoints.nominal_reach(load, settings.stage)

    @property
    def trusted(self) -> tuple[float, ...] | None:
        """The physical parameters that were trusted last; None before there are any."""
        return self._trusted

    @property
    def resolution(self) -> float:
        """The step of the output that was found in its samples; 0 while none is known."""
        return filters.step_found(self._bank.quantiser, self.settings.learning.output_scale)

    def apply(self, decision: signals.Decision) -> None:
        """Let a decision take effect from the next tick on.

        V_c stays where the operator has set it since: the decision is older.
        """
        if self._stage is signals.Stage.RUN:
            if decision.controller is not signals.Mode.MANUAL and not self._fast.by_hand:
                self._fast.boost_reference_V = decision.boost_reference_V
            self._learn(decision.k)

    def _learn(self, k: int) -> None:
        """Keep the estimates of a decision for the next run.

        Only those that took effect count: a record shows these, so that a replay keeps the same.
        """
        self._learnt = self._proposed.get(k, self._learnt)
        self._proposed = {later: kept for later, kept in self._proposed.items() if later > k}

    def _recall(self) -> None:
        """Begin a run with what the one before had trusted."""
        self._proposed = {}
        settings = self.settings
        if self._learnt is not None and settings.exact and self.state.estimator.method.physical:
            self._prior = self._learnt
            self.settings = _recalling(settings)

    def _enter(self, stage: signals.Stage, measurement: Measurement) -> None:
        """Start a stage from what is measured now, so that it begins without a bump."""
        fed = (
            self._stage is not signals.Stage.PRECHARGE
        )  # until now the load had little input or none
        self._stage = stage
        self._snapshot = None
        limits = self.settings.stage
        output, voltage = measurement.output, measurement.boost_voltage_V
        unfed = stage is signals.Stage.RUN and not fed
        held = self._held_voltage(output, voltage) if unfed else voltage
        reference = min(max(held, limits.boost_reference_min_V), limits.boost_reference_max_V)
        if stage is signals.Stage.PRECHARGE:
            reference = max(limits.boost_reference_min_V, 0.0)
        self._fast = fast.FastState(
            tick=measurement.tick,
            boost_reference_V=reference,
            error_sum=voltage_loop.initial_sum(held),
        )
        if stage is signals.Stage.RUN:
            self._recall()
            at_rest = voltage if fed else self._resting_voltage(output, voltage)
            quantiser = self._bank.quantiser  # the sensor is the same in every run
            self._bank = self._new_bank(measurement.tick_period_s, output, at_rest)
            self._bank.quantiser = quantiser
            first = held if self.load.charging is None else voltage
            self.state = new_slow_state(self.settings, self.load, output, first)
            # v_bst may hold the load at another output than this: the other lag of the response
            # watch begins there, so that a load which rests where it is need not move
            self.state.watch.slow = self.load.gain * to_input(
                voltage, self.load.input_gain, self.load.input_exponent
            )
            self._reach = setpoints.nominal_reach(self.load, limits)
            if self._prior is not None:
                learning, values = self.settings.learning, list(self._prior)
                estimator.start_from(self.state.estimator, learning, self.load, values)
                self.state.recalled = True

    def _held_voltage(self, output: float, voltage: float) -> float:
        """The voltage from which V_c begins: the measured one, at most what the load rests at.

        The capacitor may still be full from the run before: holding it would move a load, and
        charge a battery at any current.
        """
        floor_V = self.settings.stage.boost_reference_min_V
        if self.load.charging is not None:
            return floor_V
        return min(voltage, max(self._resting_voltage(output, voltage), floor_V))

    def _resting_voltage(self, output: float, voltage: float) -> float:
        """The voltage at which the load would rest at this output: 0 for one at a standstill.

        The λ filters of a load that has not been fed must not remember the voltage that was kept
        from it. A battery rests at its own EMF, whatever that is; there the measured one is kept.
        """
        load = self.load
        if load.charging is not None:
            return voltage
        load_input = output * load.denominator[-1] / load.numerator[-1]
        return max(0.0, to_voltage(load_input, load.input_gain, load.input_exponent))

    def _new_bank(self, tick_period_s: float, output: float, voltage: float) -> fast.FilterBank:
        tau = self.settings.learning.tau_lambda_s
        return fast.new_filter_bank(self.load, tick_period_s, tau, output, voltage)

    def _run_filters(self, measurement: Measurement, order: Order) -> None:
        rates = self.settings.rates
        if fast.take_in(self.settings, self.load, self._fast, self._bank, measurement):
            k = measurement.tick // rates.ticks_per_period
            self._snapshot = self._take(measurement, order, k)

    def _take(self, measurement: Measurement, order: Order, k: int) -> Snapshot:
        rates, learning, order_m = self.settings.rates, self.settings.learning, self.load.order
        held_V = self._fast.boost_reference_V if self._fast.by_hand else math.nan
        means = fast.take_means(self._bank)
        applied_V, followed, held = fast.close_period(self._fast, self.settings)
        resolution, rounding = fast.take_rounding(self.settings, self._bank)
        fast.tune_filters(self._bank, measurement.tick_period_s, learning.tau_lambda_s)
        return Snapshot(
            k=k,
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
            upcoming=self._upcoming(measurement.tick, order.waveform),
        )

    def _upcoming(self, tick: int, known: signals.KnownWaveform | None) -> tuple[float, ...]:
        """Return the set-points of the slow periods to come, none where they are not known."""
        if known is None:
            return ()
        waveform, rates = known.waveform, self.settings.rates
        ticks = [tick + i * rates.ticks_per_period for i in range(1, AHEAD)]
        asked = [
            waveform.value((later - known.begin_tick) * rates.nominal_tick_s) for later in ticks
        ]
        return tuple(map(self._reach.nearest, asked) if self.settings.govern else asked)

    def _set_by_hand(self, measurement: Measurement, order: Order) -> None:
        """Set V_c to the operator's value; a battery's terminals stay at their limit."""
        highest_V = self._bearable(measurement, 1.0)
        fast.set_by_hand(self._fast, self.settings.stage, order.manual_V, highest_V)

    def _drive(self, measurement: Measurement, bridge: bool) -> signals.Command:
        highest_V = self._bearable(measurement, ABOVE)
        scale, reference = fast.drive(self._fast, self.settings.stage, measurement, highest_V)
        return signals.Command(scale, reference, bridge)

    def _bearable(self, measurement: Measurement, share: float) -> float:
        """Return the V_c for a share of the voltage of a battery; infinite for other loads."""
        charging, voltage_V = self.load.charging, measurement.boost_voltage_V
        if charging is None:
            return math.inf
        power_W = measurement.load_power_W
        current_A = proven_current(charging, measurement.output, voltage_V, power_W)
        return boost_voltage(charging, share, current_A)

    def _sample(self, snapshot: Snapshot) -> regression.SlowSample:
        load, stage = self.load, self.settings.stage
        gain, exponent = load.input_gain, load.input_exponent
        applied = to_input(snapshot.applied_V, gain, exponent)
        return regression.SlowSample(
            period_s=snapshot.period_s,
            output=snapshot.output,
            output_filtered=list(snapshot.output_filtered),
            input_filtered=list(snapshot.input_filtered),
            applied=applied,
            followed=snapshot.followed,
            held_share=snapshot.held_ticks / self.settings.rates.ticks_per_period,
            reference=snapshot.order.reference,
            adaptive=snapshot.order.mode is signals.Mode.ADAPTIVE,
            pole=snapshot.order.pole,
            low=to_input(stage.boost_reference_min_V, gain, exponent),
            high=to_input(stage.boost_reference_max_V, gain, exponent),
            manual=snapshot.order.mode is signals.Mode.MANUAL,
            held=to_input(snapshot.held_V, gain, exponent),
            steady=snapshot.order.steady,
            lowest=self._reach.low,
            highest=self._reach.high,
            rounding=snapshot.rounding,
            upcoming=list(snapshot.upcoming),
        )

    def _estimates(self) -> dict[str, signals.Estimate]:
        state, load, learning = self.state, self.load, self.settings.learning
        deviations = [math.nan] * len(load.names)
        if math.isfinite(state.values[0]):
            deviations = state.estimator.method.shown_deviations(
                state.estimator, learning, load, state.values
            )
        estimates = {
            name: signals.Estimate(value, deviation)
            for name, value, deviation in zip(load.names, state.values, deviations, strict=True)
        }
        if learning.bias:
            offset = state.estimator.method.input_offset(state.estimator, learning, load)
            estimates["input_offset"] = signals.Estimate(offset, math.nan)
        return estimates


def _in_force(mode: signals.Mode, *, adaptive: bool) -> signals.Mode:
    """Return the source of V_c: the operator, or the law in force."""
    if mode is signals.Mode.MANUAL:
        return mode
    return signals.Mode.ADAPTIVE if adaptive else signals.Mode.FIXED


def _recalling(settings: ControllerSettings) -> ControllerSettings:
    """With a prior no warm-up is needed: its gains act at once."""
    periods = min(settings.learning.settle_periods, settings.supervision.warm_up_periods)
    return replace(settings, supervision=replace(settings.supervision, warm_up_periods=periods))


def _fault(state: SlowState, charging: Charging | None) -> str:
    """Return why the drive must be tripped, empty for no reason."""
    if state.unresponsive:
        return _UNRESPONSIVE
    if charging is not None and is_disconnected(charging, state.charge):
        return _DISCONNECTED
    if charging is not None and is_too_long(charging, state.charge):
        return _TOO_LONG.format(charging.longest_s / 3600.0)
    return _CYCLING if state.cycling else ""
