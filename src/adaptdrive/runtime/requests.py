"""Requests of an operator to a running drive, and their execution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from adaptdrive.control.signals import Mode
from adaptdrive.control.waveform import Waveform
from adaptdrive.runtime.reports import State


@dataclass(frozen=True, slots=True)
class SetSetpoint:
    """Hold a constant set-point, in the unit of the output; stops a waveform."""

    value: float


@dataclass(frozen=True, slots=True)
class SetWaveform:
    """Follow a waveform from now on; None holds the present set-point."""

    value: Waveform | None


@dataclass(frozen=True, slots=True)
class SetMode:
    """Choose the fixed or the adaptive controller, or set V_c by hand."""

    value: Mode


@dataclass(frozen=True, slots=True)
class SetVoltage:
    """Set V_c, in mode manual.

    Attributes:
        value: V_c in volts.
        hold_s: Longest time until the next one; then the drive trips. None without a limit.
    """

    value: float
    hold_s: float | None = None


@dataclass(frozen=True, slots=True)
class SetPole:
    """Choose the closed-loop pole of the load loop."""

    value: float


@dataclass(frozen=True, slots=True)
class Enable:
    """Energise the drive and hold the present output."""


@dataclass(frozen=True, slots=True)
class Disable:
    """Bring the drive into its safe state."""


@dataclass(frozen=True, slots=True)
class Reset:
    """Leave a trip whose cause is gone."""


Request = SetSetpoint | SetWaveform | SetMode | SetVoltage | SetPole | Enable | Disable | Reset


class Host(Protocol):
    """The running drive, as far as operators are concerned."""

    async def execute(self, request: Request) -> State:
        """Carry out a request between two ticks.

        Returns:
            The state after it.

        Raises:
            RefusedError: The request cannot be carried out; nothing was changed.
        """

    def trip(self, cause: str) -> None:
        """Trip at once for a cause outside the drive; the first cause stays until `reset`."""

    def stop(self) -> State:
        """Bring the drive into its safe state at once, in every state and at any time.

        It neither waits nor refuses.

        Returns:
            The state after it.
        """
