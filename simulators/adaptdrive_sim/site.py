"""A controller in front of a plant, and a whole drive in virtual time.

The order of calls is that of `adaptdrive.control.schedule`. There is no bus and no broker, and
nothing waits: time passes as fast as the machine counts it.
"""

from collections.abc import Callable, Iterator
from itertools import repeat

import numpy as np

from adaptdrive.analysis.closed_loop import Loop
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, machine_limits
from adaptdrive.config.root import Configuration
from adaptdrive.control import signals
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Reach
from adaptdrive.runtime import reports, requests, state_machine
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.course import NO_TRIPS, PERIODS, Course, Run
from adaptdrive_sim.plants.boost import Sample
from adaptdrive_sim.wire import CONTROL_FAULT, Wire, find_cause, received, rounded
from adaptdrive_sim.world import SimulatedLoad, World

# A controller in front of a plant, and the runs of both over a course.


class Site(Loop):
    """A controller in front of a world, and the wire between them.

    Attributes:
        world: The plant.
        wire: Resolution and delay.
        sample: What the drive measured at the end of the last half cycle.
    """

    def __init__(self, controller: Controller, world: World, wire: Wire | None = None) -> None:
        """Put a controller in front of a world as it is.

        Args:
            controller: The controller.
            world: The plant.
            wire: Resolution and delay; one without either when left out.
        """
        super().__init__(controller)
        self.world = world
        self.sample: Sample = world.at_rest()
        self.wire = wire or Wire([self.sample.output])
        self._noise: Iterator[float] = iter(())
        self._trips = NO_TRIPS

    def measure(self, tick: int) -> signals.Measurement:
        """Return what the controller receives at a tick."""
        measurement = received(self.wire, tick, self.sample)
        self.interlock = find_cause(measurement, *self._trips)
        return measurement

    def step(self, command: signals.Command) -> None:
        """Run the plant for one half cycle; the noise is its own outside of a course."""
        scale_S = rounded(command.current_scale_S, self.wire.scale_quantum_S)
        self.sample = self.world.step(scale_S, command.bridge, next(self._noise, None))

    def rest(self, course: Course) -> None:
        """Put the plant at rest where a course starts, and start the controller on it.

        A line with a higher peak than that output needs lets the plant rest above it.
        """
        world, line = self.world, self.world.line
        output = float(course.references[0]) if course.start is None else course.start
        needed_V = world.boost_voltage_for(output - course.offset)
        peak_V = line.voltage_V * 2.0**0.5
        world.settle(max(needed_V, peak_V))
        if needed_V < peak_V:
            output = world.true_output + course.offset
        boost_V, load_W = world.boost.voltage_V, world.boost.mean_load_W
        rest = signals.Measurement(-1, line.half_cycle_s, boost_V, line.voltage_V, load_W, output)
        order = signals.Order(signals.Stage.RUN, output, course.mode, course.pole)
        self.controller.tick(rest, order)

    def run(self, course: Course, *, keep_ticks: bool = False) -> Run:
        """Run a course, from rest.

        Args:
            course: What happens.
            keep_ticks: Keep output and boost voltage of every tick.
        """
        self.rest(course)
        run = Run.empty(len(course.references), self.controller.load.names)
        run.interlock = self._run(course, run, keep_ticks=keep_ticks)
        return run

    def _run(self, course: Course, run: Run, *, keep_ticks: bool) -> int:
        """Run a course that has begun at rest; return the interlock that has ended it."""
        world, ticks = self.world, self.controller.settings.rates.ticks_per_period
        self._trips = course.trips
        self._noise = iter(course.disturbances.tolist())
        self.sample = world.step(world.current_scale_S, world.bridge, next(self._noise))
        for measurement, _, decided in self.readings(self._orders(course, ticks)):
            if keep_ticks:
                run.fast_output.append(world.load.output)
                run.fast_voltage_V.append(measurement.boost_voltage_V)
            if decided and self.note(run, measurement.tick // ticks).fault:
                return CONTROL_FAULT
        return self.interlock

    def _orders(self, course: Course, ticks: int) -> Iterator[signals.Order]:
        """Yield the orders of a course; before the first of a slow period its load changes."""
        for k, reference in enumerate(course.references.tolist()):
            change_plant(self.world.load, course, k)
            self.upcoming = course.upcoming(k)
            yield from repeat(
                signals.Order(course.stage(k), reference, course.mode, course.pole), ticks
            )

    def note(self, run: Run, k: int) -> signals.Decision:
        """Fill the row of a slow period in which a decision was made."""
        snapshot, decision, slow = self.snapshot, self.decision, self.controller.state
        assert snapshot is not None and decision is not None  # noqa: S101, PT018 - it has decided
        load = self.controller.load
        estimates = [decision.estimates[name] for name in load.names]
        run.decisions.append(decision)
        run.trace[k] = (
            *(self.world.true_output, snapshot.output),
            *(decision.boost_reference_V, snapshot.applied_V),
            decision.controller is signals.Mode.ADAPTIVE,
            *(decision.accepted, slow.supervisor.verdict),
            *(decision.innovation, decision.handover_step_V, slow.watch.fallback),
            *(one.value for one in estimates),
            *(one.std for one in estimates),
        )
        return decision


def change_plant(load: SimulatedLoad, course: Course, k: int) -> None:
    """Change the size of a load and what disturbs it, where slow period k has other ones."""
    sizes, burdens = course.sizes, course.burdens
    if k > 0 and sizes[k] != sizes[k - 1]:
        load.resize(float(sizes[k]), course.over_s)
    if len(burdens) and (k == 0 or burdens[k] != burdens[k - 1]):
        load.disturb(float(burdens[k]))


# One drive in virtual time: the daemon's controller and state machine against a plant.


class OperatedDrive(Site):
    """A site that takes an operator's requests, with the daemon's state machine.

    Attributes:
        machine: State machine, as in the daemon.
        ticks: Half line cycles so far.
        time_s: Time so far.
        completed: Whether the load has what it needs.
    """

    def __init__(self, configuration: Configuration, world: World) -> None:
        """Put the daemon's controller in front of a plant.

        Args:
            configuration: The daemon's configuration.
            world: The plant, in whatever state it is.
        """
        controller = Controller(controller_settings(configuration), build_load(configuration))
        world.shut()
        super().__init__(controller, world)
        self.sample = world.step(0.0, bridge=False)
        self.machine = state_machine.Machine(machine_limits(configuration))
        self.ticks = 0
        self.time_s = 0.0
        self.completed = False
        self._command = signals.SAFE_COMMAND

    def begin(self, mode: signals.Mode) -> None:
        """Enable the drive, wait until it runs or trips, and ask for a controller."""
        self.tick()
        self.carry_out(requests.Enable())
        while self.machine.state is reports.State.STARTING:
            self.tick()
        self.carry_out(requests.SetMode(mode))

    def follow(
        self,
        duration_s: float,
        setpoint_at: Callable[[float], float],
        change: Callable[[float], None],
    ) -> Run:
        """Run until the load has what it needs, a trip or the end.

        Args:
            duration_s: The end.
            setpoint_at: Set-point at a time, asked for when it changes; one that is refused leaves
                the drive at the one before.
            change: Changes the plant at the end of a slow period.
        """
        run = Run(np.empty((0, 0)), (*PERIODS, *self.world.load.state()))
        rows: list[tuple[float, ...]] = []
        began_s, setpoint = self.time_s, 0.0
        while (time_s := self.time_s - began_s) < duration_s and not self.completed:
            if self.machine.trip is not None:
                run.trip = self.machine.trip.text
                break
            if setpoint_at(time_s) != setpoint:
                setpoint = setpoint_at(time_s)
                self._ask(requests.SetSetpoint(setpoint), run)
            if self.tick() and self.decision is not None:
                change(time_s)
                run.decisions.append(self.decision)
                rows.append((time_s, *self._row(self.decision)))
        run.trace = np.array(rows).reshape(len(rows), len(run.names))
        return run

    def _ask(self, request: requests.Request, run: Run) -> None:
        try:
            self.carry_out(request)
        except RefusedError as problem:
            run.refused.append(str(problem))

    def _row(self, decision: signals.Decision) -> tuple[float, ...]:
        """A ripple that is asked for is part of the reference."""
        asked = self.reference + float(np.nan_to_num(decision.probe))
        load, adaptive = self.world.load, decision.controller is signals.Mode.ADAPTIVE
        return asked, load.output, adaptive, *load.state().values()

    def carry_out(self, request: requests.Request) -> None:
        """Carry out an operator's request before the next tick.

        Raises:
            RefusedError: It cannot be done; nothing was changed.
        """
        voltage_V = self._command.boost_reference_V
        self.machine.carry_out(request, self.ticks, self.sample.output, None, voltage_V)

    def tick(self) -> bool:
        """Run one half line cycle; return whether a slow period has ended with it."""
        self.ticks += 1
        self.time_s += self.sample.tick_period_s
        self.machine.advance(self.ticks, self.sample.boost_voltage_V)
        measurement = self.measure(self.ticks)
        command, decided = self.control(measurement, self.machine.order(self.ticks))
        if decided and self.decision is not None:
            self._obey(self.decision)
        if self.machine.stage is signals.Stage.OFF:
            self.machine.forget_reach()
            self.machine.confirm_stop()
            self.world.shut()
            command, _ = self.control(measurement, self.machine.order(self.ticks))
        self._command = command
        self.step(command)
        self.machine.progress(self.ticks)
        return decided

    @property
    def reference(self) -> float:
        """The set-point in force."""
        return self.machine.reference(self.ticks)

    def _obey(self, decision: signals.Decision) -> None:
        """Trip or stop where a decision demands it, and take over what V_c can hold."""
        self.machine.reach = Reach(decision.reach_low, decision.reach_high)
        if decision.fault:
            self.machine.latch(Trip(TripKind(decision.fault_kind), decision.fault))
        elif decision.complete:
            self.completed = True
            self.carry_out(requests.Disable())
