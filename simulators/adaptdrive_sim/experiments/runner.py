"""Virtual time: the daemon's own controller against the simulated plant, as fast as it goes.

The order of calls is the daemon's: a frame, a tick of the controller, at n = kQ the slow half, at
n = kQ + L its decision takes effect. A run depends on its case alone, so it is the same each time.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import (
    Command,
    Decision,
    Measurement,
    Mode,
    Order,
    Snapshot,
    Stage,
)
from adaptdrive_sim.experiments.case import Case
from adaptdrive_sim.world import Sample, World, WorldParameters


@dataclass(slots=True)
class Record:
    """What happened: one entry per slow period, taken at its first tick.

    Attributes:
        time_s: Time since the start.
        reference: Reference.
        size: Multiple of the load's nominal inertia or volume.
        output: Output without noise.
        measured: Output as the slow half saw it.
        boost_reference_V: V_c that was decided.
        applied_V: Mean boost voltage over the period before.
        adaptive: Whether the adaptive gains were in force.
        accepted: Whether the estimate reached the adaptive gains.
        reason: Why the controller in force was in force.
        estimates: Estimated parameters, by name.
        deviations: Their standard deviations, by name.
        gains: Gains in force.
        innovation: Prediction error of the estimator.
        excitation: What the sample could teach.
        fast_output: Output without noise at every tick, where asked for.
        fast_voltage_V: Boost voltage at every tick, where asked for.
    """

    time_s: list[float] = field(default_factory=list)
    reference: list[float] = field(default_factory=list)
    size: list[float] = field(default_factory=list)
    output: list[float] = field(default_factory=list)
    measured: list[float] = field(default_factory=list)
    boost_reference_V: list[float] = field(default_factory=list)
    applied_V: list[float] = field(default_factory=list)
    adaptive: list[bool] = field(default_factory=list)
    accepted: list[bool] = field(default_factory=list)
    reason: list[str] = field(default_factory=list)
    estimates: dict[str, list[float]] = field(default_factory=dict)
    deviations: dict[str, list[float]] = field(default_factory=dict)
    gains: list[list[float]] = field(default_factory=list)
    innovation: list[float] = field(default_factory=list)
    excitation: list[float] = field(default_factory=list)
    fast_output: array[float] = field(default_factory=lambda: array("d"))
    fast_voltage_V: array[float] = field(default_factory=lambda: array("d"))


def run_case(case: Case, *, keep_ticks: bool = False) -> Record:
    """Run one case from start to end.

    Args:
        case: What to run.
        keep_ticks: Whether the record is to hold output and boost voltage of every tick.
    """
    bench = _Bench(case, keep_ticks=keep_ticks)
    rates = case.settings.rates
    for k in range(round(case.experiment.duration_s / case.experiment.period_s)):
        bench.run_period(k, rates.ticks_per_period, rates.latency_ticks)
    return bench.record


class _Bench:
    """Plant, controller and record of one run."""

    def __init__(self, case: Case, *, keep_ticks: bool) -> None:
        experiment = case.experiment
        noise = case.disturbance.scaled(experiment.step)
        self.record = Record()
        self._experiment = experiment
        self._mode = case.mode
        self._keep_ticks = keep_ticks
        self._controller = Controller(case.settings, experiment.nominal())
        self._world = World(experiment.plant(), WorldParameters(noise=noise, seed=case.seed))
        self._changes = list(experiment.changes)
        self._order = self._order_at(0.0)
        self._sample = self._start_at_rest()

    def run_period(self, k: int, ticks: int, latency: int) -> None:
        """Run one slow period, first tick first."""
        time_s, first = k * self._experiment.period_s, k * ticks
        self._order = self._order_at(time_s)
        self._change_load(time_s)
        output = self._world.true_output
        self._run_ticks(first, first + 1)
        snapshot = self._controller.take_snapshot()
        if snapshot is None:
            raise RuntimeError(f"the controller took no snapshot at tick {first}")
        decision = self._controller.decide(snapshot)
        self._run_ticks(first + 1, first + latency)
        self._controller.apply(decision)
        self._run_ticks(first + latency, first + ticks)
        self._write(time_s, output, snapshot, decision)

    def _start_at_rest(self) -> Sample:
        """Everything at rest on the lower value of the reference, controller included."""
        world, low = self._world, self._experiment.reference.low
        world.settle(world.boost_voltage_for(low))
        boost = world.boost
        at_rest = Measurement(
            tick=-1,
            tick_period_s=world.line.half_cycle_s,
            boost_voltage_V=boost.voltage_V,
            line_voltage_V=world.line.voltage_V,
            load_power_W=boost.mean_load_W,
            output=low,
        )
        order = Order(Stage.RUN, low, self._mode, self._experiment.pole)
        self._controller.tick(at_rest, order)
        return world.step(world.current_scale_S, bridge=True)

    def _order_at(self, time_s: float) -> Order:
        experiment = self._experiment
        reference = experiment.reference.value(time_s)
        return Order(Stage.RUN, reference, self._mode, experiment.pole)

    def _change_load(self, time_s: float) -> None:
        if self._changes and time_s >= self._changes[0].time_s:
            change = self._changes.pop(0)
            self._experiment.resize(self._world.load, change.size, change.over_s)

    def _run_ticks(self, first: int, last: int) -> None:
        """The ticks first <= n < last; every cycle counts in here."""
        tick, step, order, sample = (
            self._controller.tick,
            self._world.step,
            self._order,
            self._sample,
        )
        for n in range(first, last):
            if self._keep_ticks:
                self.record.fast_output.append(self._world.load.output)
                self.record.fast_voltage_V.append(sample.boost_voltage_V)
            command: Command = tick(
                Measurement(
                    n,
                    sample.tick_period_s,
                    sample.boost_voltage_V,
                    sample.line_voltage_V,
                    sample.load_power_W,
                    sample.output,
                ),
                order,
            )
            sample = step(command.current_scale_S, command.bridge)
        self._sample = sample

    def _write(self, time_s: float, output: float, snapshot: Snapshot, decision: Decision) -> None:
        record = self.record
        record.time_s.append(time_s)
        record.reference.append(snapshot.order.reference)
        record.size.append(self._experiment.size_at(time_s))
        record.output.append(output)
        record.measured.append(snapshot.output)
        record.boost_reference_V.append(decision.boost_reference_V)
        record.applied_V.append(snapshot.applied_V)
        record.adaptive.append(decision.controller is Mode.ADAPTIVE)
        record.accepted.append(decision.accepted)
        record.reason.append(decision.reason)
        record.gains.append(list(decision.gains))
        record.innovation.append(decision.innovation)
        record.excitation.append(decision.excitation)
        for name, estimate in decision.estimates.items():
            record.estimates.setdefault(name, []).append(estimate.value)
            record.deviations.setdefault(name, []).append(estimate.std)
