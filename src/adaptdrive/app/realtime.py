"""`[realtime]` at start: rehearse, request the settings, and report the kernel's answers.

A rehearsal has ticks and slow steps on synthetic readings. Before the first real one it makes
imports and memory ready, so that the first real ticks take no longer than later ones. Shortly
before each real one it fills the caches of the CPU.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, daemon_settings
from adaptdrive.config import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Mode, Snapshot
from adaptdrive.control.supervision.setpoints import Reach
from adaptdrive.devices.port import Port, Reading
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.realtime import Grant, real_time
from adaptdrive.runtime.reports import Event, Hub, Severity
from adaptdrive.runtime.requests import Disable, Enable, Request, SetMode, SetSetpoint
from adaptdrive.runtime.state_machine import Machine

_PERIODS = 4
_READINGS_AT_MOST = 2400
_READINGS_TO_RUN = 4


class Rehearsal:
    """A scratch controller and a scratch fast loop, whose surroundings it is: all goes well."""

    def __init__(self, configuration: Configuration, port: Port) -> None:
        """Rehearse nothing yet.

        Args:
            configuration: The drive.
            port: A separate port, which is not open: it encodes, and nothing reaches a wire.
        """
        self._configuration = configuration
        self._time_s = 0.0
        self._snapshots: list[Snapshot] = []
        self._settings = daemon_settings(configuration)
        settings, load = controller_settings(configuration), build_load(configuration)
        self._port, self._controller = port, Controller(settings, load)
        self._machine = Machine(self._settings.machine, self._settings.pole)
        self._loop = FastLoop(port, self._controller, self._machine, self._settings.fast, self)
        self._readings = 0
        self._output = _reachable_output(configuration, self._settings.machine.reach)

    def run(self) -> int:
        """Go through start, run and stop.

        Returns:
            Ticks run.
        """
        readings = min(_READINGS_AT_MOST, _PERIODS * self._configuration.ticks_per_period)
        self._start(readings)
        self._loop.on_deadline(self._time_s)
        self._machine.carry_out(Disable(), self._loop.tick, math.nan, None)
        self._loop.send_safe()
        self._machine.confirm_stop()  # no drive is there to do it
        return self._loop.counts.ticks

    def tick(self) -> None:
        """One tick of a drive that runs, from its frames to a command; the first one starts it."""
        if not self._machine.energised:
            self._start(_READINGS_TO_RUN)
        self._port.rehearse()
        self._read()
        self._snapshots.clear()

    def now_s(self) -> float:
        """Return the simulated time."""
        return self._time_s

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        """Keep it for the controller."""
        self._snapshots.append(snapshot)
        return True

    def run_ended(self) -> None:
        """Forget what waits for the controller."""
        self._snapshots.clear()

    def arm(self, *_values: object, **_named: object) -> None:
        """Do nothing: no timer stands in, and nobody looks."""

    met_deadline = ticked = decided = not_stopped = arm

    def _start(self, readings: int) -> None:
        """Start the drive, and keep it running for the rest of so many readings."""
        for number in range(readings):
            self._read()
            if number == _READINGS_TO_RUN // 2:
                self._carry_out(SetMode(Mode.ADAPTIVE))
                self._carry_out(Enable())
                self._carry_out(SetSetpoint(self._output))
            for snapshot in tuple(self._snapshots):
                self._snapshots.clear()
                self._loop.deliver(snapshot, self._controller.decide(snapshot))

    def _carry_out(self, request: Request) -> None:
        loop = self._loop
        self._machine.carry_out(request, loop.tick, self._output, loop.cause)

    def _read(self) -> None:
        configuration = self._configuration
        self._time_s += configuration.timing.reading_s
        bridge = self._loop.command.bridge
        output = self._output * (1.0 + 0.001 * math.sin(0.1 * self._readings))
        reading = _reading(configuration, output, self._time_s, bridge=bridge)
        self._loop.on_reading(reading)
        self._readings += 1


def _reachable_output(configuration: Configuration, reach: Reach) -> float:
    """Return the middle of the set-points that V_c can hold by the nominal model."""
    low, high = configuration.load.reference_min, configuration.load.reference_max
    if reach.is_known:
        low, high = max(low, reach.low), min(high, reach.high)
    return 0.5 * (low + high)


def _reading(
    configuration: Configuration, output: float, time_s: float, *, bridge: bool
) -> Reading:
    limits = configuration.drive.limits
    return Reading(
        arrival_s=time_s,
        oldest_s=time_s,
        counter=None,
        boost_voltage_V=0.5 * (limits.boost_reference_min_V + limits.boost_reference_max_V),
        line_voltage_V=configuration.drive.line_voltage_V,
        load_power_W=0.1 * limits.load_power_max_W,
        output=output,
        fault=0,
        bridge=bridge,
    )


@contextmanager
def prepared(configuration: Configuration, rehearsal: Rehearsal, hub: Hub) -> Iterator[None]:
    """Rehearse, ask for what is configured, and publish an event for each answer.

    Args:
        configuration: The drive.
        rehearsal: Of its ticks.
        hub: Where the events go.
    """
    grants: list[Grant] = []
    if configuration.realtime.warm_up:
        began_s = time.monotonic()
        ticks = rehearsal.run()
        spent_ms = (time.monotonic() - began_s) * 1e3
        meaning = f"{ticks} ticks rehearsed in {spent_ms:.0f} ms"
        grants.append(Grant("warm_up = true", granted=True, meaning=meaning))
    grants.extend(before_frames(configuration))
    with real_time(configuration.realtime) as answers:
        for grant in (*grants, *answers):
            hub.publish(_event(grant))
        yield


def before_frames(configuration: Configuration) -> Iterator[Grant]:
    """Return the work to do before each frame of the drive, and its description.

    Args:
        configuration: The drive.
    """
    wanted, tick_us = configuration.realtime, 0.5e6 / configuration.drive.line_frequency_Hz
    polled = configuration.bus.ticks_per_reading > 1
    if wanted.rehearse_us > 0.0:
        meaning = "a tick on a made-up drive before each frame keeps the CPU's caches warm"
        if polled:
            meaning = "a drive that is polled answers, and its replies must not wait for it"
        yield Grant(f"rehearse_us = {wanted.rehearse_us:g}", granted=not polled, meaning=meaning)
    if wanted.spin_us > 0.0:
        before = "each deadline of the timer" if polled else "each frame and deadline"
        share = 100.0 * wanted.spin_us / tick_us
        meaning = f"busy before {before}, up to {share:.0f} % of a CPU"
        yield Grant(f"spin_us = {wanted.spin_us:g}", granted=True, meaning=meaning)


def _event(grant: Grant) -> Event:
    severity = Severity.INFO if grant.granted else Severity.WARNING
    answer = "granted" if grant.granted else "refused"
    return Event("realtime", severity, f"{grant.asked} {answer}: {grant.meaning}", -1)
