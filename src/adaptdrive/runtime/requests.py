"""Requests of an operator to a running drive: the registry of all commands.

A request is one class: its verb in the topic, and its fields as they stand in the payload. The
state machine carries it out. `REQUESTS` lists them; messages and command line are made of it.
"""

from dataclasses import dataclass
from typing import ClassVar, Protocol

from adaptdrive.control.signals import Mode, Waveform
from adaptdrive.runtime.reports import State
from adaptdrive.safety.trips import Trip


@dataclass(frozen=True, slots=True)
class Request:
    """An operator's request; the first line of its description is that of the command.

    Attributes:
        verb: Last part of the topic, and name on the command line.
    """

    verb: ClassVar[str]


@dataclass(frozen=True, slots=True)
class SetSetpoint(Request):
    """Hold a constant set-point, in the unit of the output; stops a waveform.

    Attributes:
        value: The set-point.
        slope: Change of the reference in one second on its way there; None for
            `load.reference_slope`.
    """

    verb = "setpoint"
    value: float
    slope: float | None = None


@dataclass(frozen=True, slots=True)
class SetWaveform(Request):
    """Follow a periodic set-point, or hold the present one (`off`).

    Attributes:
        value: The set-point.
        preview: Whether the controller may move before what comes.
    """

    verb = "waveform"
    value: Waveform | None
    preview: bool = True


@dataclass(frozen=True, slots=True)
class SetMode(Request):
    """Choose the fixed or the adaptive controller, or manual."""

    verb = "mode"
    value: Mode


@dataclass(frozen=True, slots=True)
class SetVoltage(Request):
    """Set V_c in mode manual.

    Attributes:
        value: V_c in V.
        hold_s: Longest time until the next one in s; then the drive trips. None without a limit.
    """

    verb = "voltage"
    value: float
    hold_s: float | None = None


@dataclass(frozen=True, slots=True)
class SetPole(Request):
    """Choose the closed-loop pole of the load loop."""

    verb = "pole"
    value: float


@dataclass(frozen=True, slots=True)
class Enable(Request):
    """Energise a drive and hold the present output."""

    verb = "enable"


@dataclass(frozen=True, slots=True)
class Disable(Request):
    """Bring a drive into its safe state."""

    verb = "disable"


@dataclass(frozen=True, slots=True)
class Reset(Request):
    """Leave a trip whose cause is gone."""

    verb = "reset"


@dataclass(frozen=True, slots=True)
class Reload(Request):
    """Take the load and the limits of the file, between two runs.

    Attributes:
        measured: SHA-256 of the file whose model was measured: the estimates start from it. The
            daemon refuses where its own file is another one. None for no such file.
    """

    verb = "reload"
    measured: str | None = None


REQUESTS: dict[str, type[Request]] = {
    request.verb: request
    for request in (
        SetSetpoint,
        SetWaveform,
        SetPole,
        SetMode,
        SetVoltage,
        Enable,
        Disable,
        Reload,
        Reset,
    )
}
"""All requests by verb, in the order of the command line's help."""


class Host(Protocol):
    """The running drive, as far as operators are concerned."""

    async def execute(self, request: Request) -> State:
        """Carry out a request between two ticks.

        Returns:
            The state after it.

        Raises:
            RefusedError: The request cannot be carried out; nothing was changed.
        """

    def trip(self, cause: Trip) -> None:
        """Trip at once for a cause outside the drive; the first cause stays until `reset`."""

    def stop(self) -> State:
        """Bring the drive into its safe state at once, in every state and at any time.

        It neither waits nor refuses.

        Returns:
            The state after it.
        """
