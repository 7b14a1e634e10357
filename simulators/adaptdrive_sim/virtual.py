"""One drive in virtual time: the daemon's controller and state machine against a plant."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, daemon_settings
from adaptdrive.config.root import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import SAFE_COMMAND, Decision, Mode, Stage
from adaptdrive.control.supervision.setpoints import Reach
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Disable, Enable, Request, SetMode, SetSetpoint
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.course import PERIODS, Run
from adaptdrive_sim.site import Site
from adaptdrive_sim.world import World


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
        settings = daemon_settings(configuration)
        self.machine = Machine(settings.machine, settings.pole)
        self.ticks = 0
        self.time_s = 0.0
        self.completed = False
        self._command = SAFE_COMMAND

    def begin(self, mode: Mode) -> None:
        """Enable the drive, wait until it runs or trips, and ask for a controller."""
        self.tick()
        self.carry_out(Enable())
        while self.machine.state is State.STARTING:
            self.tick()
        self.carry_out(SetMode(mode))

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
                run.trip = self.machine.trip
                break
            if setpoint_at(time_s) != setpoint:
                setpoint = setpoint_at(time_s)
                self._ask(SetSetpoint(setpoint), run)
            if self.tick() and self.decision is not None:
                change(time_s)
                run.decisions.append(self.decision)
                rows.append((time_s, *self._row(self.decision)))
        run.trace = np.array(rows).reshape(len(rows), len(run.names))
        return run

    def _ask(self, request: Request, run: Run) -> None:
        try:
            self.carry_out(request)
        except RefusedError as problem:
            run.refused.append(str(problem))

    def _row(self, decision: Decision) -> tuple[float, ...]:
        """A ripple that is asked for is part of the reference."""
        asked = self.reference + float(np.nan_to_num(decision.probe))
        load, adaptive = self.world.load, decision.controller is Mode.ADAPTIVE
        return asked, load.output, adaptive, *load.state().values()

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
        command, decided = self.control(measurement, self.machine.order(self.ticks))
        if decided and self.decision is not None:
            self._obey(self.decision)
        if self.machine.stage is Stage.OFF:
            self.machine.forget_reach()
            self.machine.confirm_stop()
            self.world.shut()
            command, _ = self.control(measurement, self.machine.order(self.ticks))
        self._command = command
        self.advance(command)
        return decided

    @property
    def reference(self) -> float:
        """The set-point in force."""
        return self.machine.reference(self.ticks)

    def _obey(self, decision: Decision) -> None:
        """Trip or stop where a decision demands it, and take over what V_c can hold."""
        self.machine.reach = Reach(decision.reach_low, decision.reach_high)
        if decision.fault:
            self.machine.latch(decision.fault)
        elif decision.complete:
            self.completed = True
            self.carry_out(Disable())
