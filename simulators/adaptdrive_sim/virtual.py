"""One drive in virtual time: the daemon's controller and state machine against a simulated plant.

The order of calls is the daemon's: a frame, the machine, a tick of the controller; at n = kQ the
slow half, whose decision takes effect at n = kQ + L. There is no bus and no broker, and nothing
waits: time passes as fast as the machine counts it.
"""

from __future__ import annotations

import math

from adaptdrive.app.settings import build_load, controller_settings, daemon_settings
from adaptdrive.config.root import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Decision, Measurement, Order, Snapshot, Stage
from adaptdrive.runtime.machine import Machine
from adaptdrive.runtime.requests import Disable, Request
from adaptdrive_sim.world import World


class VirtualDrive:
    """A controlled drive whose time passes when it is told to.

    Attributes:
        world: The plant.
        machine: State and wishes, as in the daemon.
        ticks: Half line cycles so far.
        time_s: Time so far.
        snapshot: The last snapshot, None before the first.
        decision: What the slow half made of it.
        completed: Whether the load has what it needs.
    """

    def __init__(self, configuration: Configuration, world: World) -> None:
        """Put the daemon's controller in front of a plant.

        Args:
            configuration: The daemon's configuration.
            world: The plant, in whatever state it is.
        """
        settings = daemon_settings(configuration)
        self.world = world
        self.machine = Machine(settings.machine, settings.pole)
        self.ticks = 0
        self.time_s = 0.0
        self.snapshot: Snapshot | None = None
        self.decision: Decision | None = None
        self.completed = False
        self._controller = Controller(controller_settings(configuration), build_load(configuration))
        self._latency_ticks = configuration.load.latency_ticks
        self._due: Decision | None = None
        world.shut()
        self._sample = world.step(0.0, bridge=False)

    def carry_out(self, request: Request) -> None:
        """Carry out an operator's request before the next tick.

        Raises:
            RefusedError: It cannot be done; nothing was changed.
        """
        self.machine.carry_out(request, self.ticks, self._sample.output, None)

    def tick(self) -> bool:
        """Run one half line cycle; says whether a slow period has ended with it."""
        self.ticks += 1
        self.time_s += self._sample.tick_period_s
        self.machine.advance(self.ticks, self._sample.boost_voltage_V)
        self._apply_due()
        command = self._controller.tick(self._measurement(), self._order())
        snapshot = self._controller.take_snapshot()
        if snapshot is not None:
            self._decide(snapshot)
        if self.machine.stage is Stage.OFF:
            self.world.shut()
            command = self._controller.tick(self._measurement(), self._order())
        self._sample = self.world.step(command.current_scale_S, command.bridge)
        return snapshot is not None

    @property
    def boost_voltage_V(self) -> float:
        """v_bst as last measured."""
        return self._sample.boost_voltage_V

    @property
    def load_power_W(self) -> float:
        """Power of the load as last measured."""
        return self._sample.load_power_W

    @property
    def output(self) -> float:
        """The regulated quantity as last measured."""
        return self._sample.output

    @property
    def reference(self) -> float:
        """The set-point in force."""
        return self.machine.reference(self.ticks)

    def _measurement(self) -> Measurement:
        sample = self._sample
        return Measurement(
            self.ticks,
            sample.tick_period_s,
            sample.boost_voltage_V,
            sample.line_voltage_V,
            sample.load_power_W,
            sample.output,
        )

    def _order(self) -> Order:
        machine = self.machine
        return Order(machine.stage, self.reference, machine.mode, machine.pole)

    def _apply_due(self) -> None:
        if self._due is not None and self._ticks_since_snapshot() >= self._latency_ticks:
            self._controller.apply(self._due)
            self._due = None

    def _ticks_since_snapshot(self) -> float:
        return self.ticks - self.snapshot.tick if self.snapshot is not None else math.inf

    def _decide(self, snapshot: Snapshot) -> None:
        decision = self._controller.decide(snapshot)
        self.snapshot, self.decision, self._due = snapshot, decision, decision
        if decision.fault:
            self.machine.latch(decision.fault)
        elif decision.complete:
            self.completed = True
            self.carry_out(Disable())
