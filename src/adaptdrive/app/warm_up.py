"""Rehearsal: ticks and slow steps before the first real one, on a drive that is made up.

Caches, imports and memory are then ready, and the first real ticks take no longer than later ones.
"""

from __future__ import annotations

import math

from adaptdrive.app.settings import build_load, controller_settings, daemon_settings
from adaptdrive.config import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Decision, Mode, Snapshot
from adaptdrive.hardware.port import Port, Reading
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.machine import Machine
from adaptdrive.runtime.reports import TickReport
from adaptdrive.runtime.requests import Disable, Enable, SetMode

_PERIODS = 4
_READINGS_AT_MOST = 2400


class _Nobody:
    """Surroundings that only keep the time, which runs as fast as it is told to."""

    def __init__(self) -> None:
        self.time_s = 0.0
        self.snapshots: list[Snapshot] = []

    def now_s(self) -> float:
        return self.time_s

    def arm(self, deadline_s: float) -> None:
        """No timer stands in."""

    def met_deadline(self, now_s: float) -> None:
        """Nobody watches."""

    def ticked(self, report: TickReport) -> None:
        """Nobody listens."""

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        self.snapshots.append(snapshot)
        return True

    def decided(self, snapshot: Snapshot, decision: Decision) -> None:
        """Nobody listens."""

    def run_ended(self) -> None:
        self.snapshots.clear()


def warm_up(configuration: Configuration, port: Port) -> int:
    """Run a scratch controller and a scratch fast loop through start, run and stop.

    Args:
        configuration: The drive.
        port: A port of its own, which is not open: it encodes, and nothing reaches a wire.

    Returns:
        Ticks run.
    """
    settings, nobody = daemon_settings(configuration), _Nobody()
    controller = Controller(controller_settings(configuration), build_load(configuration))
    machine = Machine(settings.machine, settings.pole)
    loop = FastLoop(port, controller, machine, settings.fast, nobody)
    readings = min(_READINGS_AT_MOST, _PERIODS * configuration.ticks_per_period)
    for number in range(readings):
        nobody.time_s += configuration.ticks_per_reading * settings.fast.tick_s
        loop.on_reading(_reading(configuration, number, nobody.time_s))
        if number == 2:
            machine.carry_out(SetMode(Mode.ADAPTIVE), loop.tick, _output(configuration), None)
            machine.carry_out(Enable(), loop.tick, _output(configuration), loop.cause)
        for snapshot in tuple(nobody.snapshots):
            nobody.snapshots.clear()
            loop.deliver(snapshot, controller.decide(snapshot))
    loop.on_deadline(nobody.time_s)
    machine.carry_out(Disable(), loop.tick, _output(configuration), None)
    loop.send_safe()
    return loop.counts.ticks


def _output(configuration: Configuration) -> float:
    return 0.5 * (configuration.load.reference_min + configuration.load.reference_max)


def _reading(configuration: Configuration, number: int, time_s: float) -> Reading:
    limits = configuration.drive.limits
    return Reading(
        arrival_s=time_s,
        oldest_s=time_s,
        counter=None,
        boost_voltage_V=0.5 * (limits.boost_reference_min_V + limits.boost_reference_max_V),
        line_voltage_V=configuration.drive.line_voltage_V,
        load_power_W=0.1 * limits.load_power_max_W,
        output=_output(configuration) * (1.0 + 0.001 * math.sin(0.1 * number)),
        fault=0,
        bridge=True,
    )
