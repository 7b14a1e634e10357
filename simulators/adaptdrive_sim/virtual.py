"""One drive in virtual time: the daemon's controller against a simulated plant.

The order of calls is that of `adaptdrive.control.schedule`. There is no bus and no broker, and
nothing waits: time passes as fast as the machine counts it.
"""

from __future__ import annotations

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, daemon_settings
from adaptdrive.config.root import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.reach import Reach
from adaptdrive.control.schedule import Schedule
from adaptdrive.control.signals import (
    SAFE_COMMAND,
    Command,
    Decision,
    Measurement,
    Order,
    Snapshot,
    Stage,
)
from adaptdrive.runtime.machine import Machine
from adaptdrive.runtime.requests import Disable, Request
from adaptdrive_sim.compiled.wire import Wire, delayed, rounded
from adaptdrive_sim.world import Sample, World


class VirtualDrive:
    """A controller in front of a plant, with or without a wire between them.

    Attributes:
        world: The plant.
        sample: What the drive measured at the end of the last half cycle.
        snapshot: The last snapshot, None before the first.
        decision: What the slow half made of it.
    """

    def __init__(
        self,
        controller: Controller,
        latency_ticks: int,
        world: World,
        sample: Sample,
        wire: Wire | None = None,
    ) -> None:
        """Put a controller in front of a plant.

        Args:
            controller: The controller.
            latency_ticks: L, ticks from a snapshot to the effect of its decision.
            world: The plant.
            sample: The plant's first measurement.
            wire: Resolution and delay between them; none when left out.
        """
        self.world = world
        self.sample = sample
        self.snapshot: Snapshot | None = None
        self.decision: Decision | None = None
        self._schedule = Schedule(controller, latency_ticks)
        self._wire = wire

    def measure(self, tick: int) -> Measurement:
        """Return what the controller receives at a tick, which it may ask for once."""
        _, tick_period_s, boost_V, line_V, load_W, output, _ = self.sample
        if (wire := self._wire) is not None:
            boost_V = rounded(boost_V, wire.voltage_quantum_V)
            line_V = rounded(line_V, wire.voltage_quantum_V)
            load_W = rounded(load_W, wire.power_quantum_W)
            output = delayed(wire, output)
        return Measurement(tick, tick_period_s, boost_V, line_V, load_W, output)

    def control(self, measurement: Measurement, order: Order) -> tuple[Command, bool]:
        """Run the controller for one tick; return whether it has decided."""
        command = self._schedule.tick(measurement, order)
        snapshot = self._schedule.take_snapshot()
        if snapshot is not None:
            self.snapshot, self.decision = snapshot, self._schedule.decide(snapshot)
        return command, snapshot is not None

    def advance(self, command: Command, disturbance: float | None = None) -> None:
        """Run the plant for one half cycle; the noise is its own unless it is given."""
        scale_S = command.current_scale_S
        if self._wire is not None:
            scale_S = rounded(scale_S, self._wire.scale_quantum_S)
        if disturbance is None:
            self.sample = self.world.step(scale_S, command.bridge)
        else:
            self.sample = self.world.step_disturbed(scale_S, command.bridge, disturbance)


class OperatedDrive(VirtualDrive):
    """A drive that takes an operator's requests, with the daemon's state machine.

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
        sample = world.step(0.0, bridge=False)
        super().__init__(controller, configuration.load.latency_ticks, world, sample)
        settings = daemon_settings(configuration)
        self.machine = Machine(settings.machine, settings.pole)
        self.ticks = 0
        self.time_s = 0.0
        self.completed = False
        self._command = SAFE_COMMAND

    def carry_out(self, request: Request) -> None:
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
        command, decided = self.control(measurement, self._order())
        if decided and self.decision is not None:
            self._obey(self.decision)
        if self.machine.stage is Stage.OFF:
            self.machine.forget_reach()
            self.machine.confirm_stop()
            self.world.shut()
            command, _ = self.control(measurement, self._order())
        self._command = command
        self.advance(command)
        return decided

    @property
    def reference(self) -> float:
        """The set-point in force."""
        return self.machine.reference(self.ticks)

    def _order(self) -> Order:
        machine = self.machine
        manual_V = machine.manual_V(self.ticks)
        return Order(
            machine.stage, self.reference, machine.mode, machine.pole, manual_V, machine.steady
        )

    def _obey(self, decision: Decision) -> None:
        """Trip or stop where a decision demands it, and take over what V_c can hold."""
        self.machine.reach = Reach(decision.reach_low, decision.reach_high)
        if decision.fault:
            self.machine.latch(decision.fault)
        elif decision.complete:
            self.completed = True
            self.carry_out(Disable())
