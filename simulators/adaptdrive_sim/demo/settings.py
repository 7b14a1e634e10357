"""What the command line says about a demonstration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from adaptdrive.errors import AdaptdriveError, RefusedError

ModeChoice = Literal["alternate", "fixed", "adaptive"]
InterfaceChoice = Literal["socketcan", "udp_multicast"]

DRIVE = "motor"
"""Name of the drive in the packaged configuration."""

LOW_V, HIGH_V = 3.0, 3.2
"""The square wave, in tachometer volts."""

REST_BOOST_V = 272.7
"""Boost voltage at which the motor rests at `LOW_V`."""


class DemoError(AdaptdriveError):
    """The demonstration cannot go on; the message says why."""


@dataclass(frozen=True, slots=True)
class DemoSettings:
    """See `adaptdrive-sim demo motor --help`.

    Attributes:
        duration_s: Seconds of control; until interrupted when None.
        headless: One line of JSON at the end instead of the live view.
        broker: HOST:PORT of a running broker; one is started when None.
        interface: Bus interface; the best one found when None.
        channel: Channel of that interface; its usual one when None.
        period_s: Period of the square wave.
        noise: Standard deviation of each sample, as a fraction of the wave's step.
        mode: Controller to ask for; `alternate` shows both in turn.
        disks: Whether disks are dropped.
        steady: Hold the set-point instead of following the wave.
        directory: Where everything is kept; a new folder in `build/demo` when None.
    """

    duration_s: float | None = None
    headless: bool = False
    broker: str | None = None
    interface: InterfaceChoice | None = None
    channel: str | None = None
    period_s: float = 60.0
    noise: float = 0.002
    mode: ModeChoice = "alternate"
    disks: bool = True
    steady: bool = False
    directory: Path | None = None

    def check(self) -> None:
        """Refuse what cannot be done.

        Raises:
            RefusedError: Which option, and why.
        """
        if self.duration_s is not None and not 1.0 <= self.duration_s < math.inf:
            raise RefusedError(f"--duration {self.duration_s:g} must be at least 1 second")
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
