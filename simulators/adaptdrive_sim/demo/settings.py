"""Command-line settings of a demonstration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from adaptdrive.cli.integers import Integer
from adaptdrive.errors import AdaptdriveError, RefusedError
from adaptdrive_sim.device_settings import InterfaceChoice

ModeChoice = Literal["alternate", "fixed", "adaptive"]

DRIVE = "motor"
"""Name of the drive in the packaged configuration."""

LOW_V, HIGH_V = 3.0, 3.2
"""The square wave, in tachometer volts."""

REST_BOOST_V = 272.7
"""Boost voltage at which the motor rests at `LOW_V`."""


SPEED_MAX = 1e6
"""Times real time: more than any machine reaches."""


class DemoError(AdaptdriveError):
    """The demonstration cannot go on; the message gives the reason."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class DemoSettings:
    """The options of `adaptdrive-sim demo motor`.

    Attributes:
        duration_s: Seconds of control after the start; until interrupted when left out.
        headless: Show nothing; print one line of JSON at the end.
        broker: HOST:PORT of a running MQTT broker; one is started when left out.
        interface: Bus interface; the best one found when left out.
        channel: Channel of that interface, such as vcan1 or a multicast group.
        period_s: Seconds of one period of the square wave (the published experiment has 120).
        noise: Standard deviation of each sample of the speed, as a fraction of the wave's step.
        mode: Controller to ask for; alternate shows both in turn, the others ask once.
        disks: Drop disks onto the shaft and take them off.
        steady: Hold the set-point instead of following the wave.
        directory: Folder for configuration, logs and sessions; build/demo/TIME when left out.
    """

    duration_s: Annotated[float | None, Parameter(name="--duration")] = None
    headless: Annotated[bool, Parameter(negative=())] = False
    broker: str | None = None
    interface: InterfaceChoice | None = None
    channel: str | None = None
    period_s: Annotated[float, Parameter(name="--period")] = 60.0
    noise: float = 0.002
    mode: ModeChoice = "alternate"
    disks: bool = True
    steady: Annotated[bool, Parameter(negative=())] = False
    directory: Path | None = None

    def check(self) -> None:
        """Refuse what cannot be done.

        Raises:
            RefusedError: Which option, and why.
        """
        _check_duration(self.duration_s)
        if not 20.0 <= self.period_s <= 3600.0:
            raise RefusedError(f"--period {self.period_s:g} must lie in 20…3600 seconds")
        if not 0.0 <= self.noise <= 1.0:
            raise RefusedError(f"--noise {self.noise:g} must lie in 0…1 of the step")
        if self.channel is not None and self.interface is None:
            raise RefusedError(f"--channel {self.channel} needs --interface")

    @property
    def noise_V(self) -> float:
        """Standard deviation of each sample of the output."""
        return self.noise * (HIGH_V - LOW_V)


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class VirtualSettings:
    """The options of `adaptdrive-sim demo bath`, `battery` and `braking`.

    Attributes:
        load: What is controlled.
        speed: Times real time.
        duration_s: Seconds of control, in virtual time; until a battery is full, or interrupted
            while it is watched, when left out.
        headless: Show nothing; print one line of JSON at the end.
        mode: Controller to ask for; alternate shows both in turn, the others ask once.
        noise: Standard deviation of each sample, in kelvin or ampere; 0.05 K for a bath and
            0.02 A for a battery when left out (0.4 mV for `braking`).
        seed: Seed of the noise.
    """

    load: Annotated[Literal["bath", "battery", "braking"], Parameter(parse=False)] = "bath"
    speed: float = 60.0
    duration_s: Annotated[float | None, Parameter(name="--duration")] = None
    headless: Annotated[bool, Parameter(negative=())] = False
    mode: ModeChoice = "alternate"
    noise: float | None = None
    seed: Integer = 0

    def check(self) -> None:
        """Refuse what cannot be done.

        Raises:
            RefusedError: Which option, and why.
        """
        _check_duration(self.duration_s)
        if not 0.0 < self.speed <= SPEED_MAX:
            raise RefusedError(f"--speed {self.speed:g} must lie above 0, and up to 1e6")
        if self.noise is not None and not 0.0 <= self.noise <= 1.0:
            raise RefusedError(f"--noise {self.noise:g} must lie in 0…1")


def _check_duration(duration_s: float | None) -> None:
    if duration_s is not None and not 1.0 <= duration_s < math.inf:
        raise RefusedError(f"--duration {duration_s:g} must be at least 1 second")
