"""Requests of an operator to a running drive: the registry of all commands.

A request is one class: its verb in the topic, its fields as they stand in the payload, and what it
does to the state machine. `REQUESTS` lists them; messages and command line are made from that list.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

from adaptdrive.control.signals import Mode
from adaptdrive.control.waveform import Waveform
from adaptdrive.errors import RefusedError
from adaptdrive.runtime.reports import State

if TYPE_CHECKING:
    from adaptdrive.runtime.machine import Machine


@dataclass(frozen=True, slots=True)
class Moment:
    """Present values that a request may depend on.

    Attributes:
        tick: Number of the present tick.
        output: Present output, NaN while unknown.
        cause: Interlock that is active now, None for none.
        voltage_V: V_c in force, NaN while unknown.
    """

    tick: int
    output: float
    cause: str | None
    voltage_V: float


@dataclass(frozen=True, slots=True)
class Request:
    """An operator's request; the first line of its description is that of the command.

    Attributes:
        verb: Last part of the topic, and name on the command line.
    """

    verb: ClassVar[str]

    def apply(self, machine: Machine, now: Moment) -> None:
        """Carry the request out.

        Args:
            machine: Overwritten.
            now: Present values.

        Raises:
            RefusedError: It cannot be carried out; nothing was changed.
        """
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class SetSetpoint(Request):
    """Hold a constant set-point, in the unit of the output; stops a waveform."""

    verb = "setpoint"
    value: float

    def apply(self, machine: Machine, _: Moment) -> None:
        """Set the set-point."""
        machine.set_setpoint(self.value)


@dataclass(frozen=True, slots=True)
class SetWaveform(Request):
    """Follow a periodic set-point, or hold the present one (`off`).

    Attributes:
        value: The set-point.
        preview: Whether the controller may know what comes.
    """

    verb = "waveform"
    value: Waveform | None
    preview: bool = False

    def apply(self, machine: Machine, now: Moment) -> None:
        """Start or stop the waveform."""
        machine.set_waveform(self.value, now.tick, preview=self.preview)


@dataclass(frozen=True, slots=True)
class SetMode(Request):
    """Choose the fixed or the adaptive controller, or manual."""

    verb = "mode"
    value: Mode

    def apply(self, machine: Machine, now: Moment) -> None:
        """Set the mode."""
        machine.set_mode(self.value, now.tick, now.output, now.voltage_V)


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

    def apply(self, machine: Machine, now: Moment) -> None:
        """Set V_c."""
        machine.set_voltage(self.value, self.hold_s, now.tick)


@dataclass(frozen=True, slots=True)
class SetPole(Request):
    """Choose the closed-loop pole of the load loop."""

    verb = "pole"
    value: float

    def apply(self, machine: Machine, _: Moment) -> None:
        """Set the pole."""
        machine.set_pole(self.value)


@dataclass(frozen=True, slots=True)
class Enable(Request):
    """Energise a drive and hold the present output."""

    verb = "enable"

    def apply(self, machine: Machine, now: Moment) -> None:
        """Start the drive."""
        machine.enable(now.output, now.cause, now.tick)


@dataclass(frozen=True, slots=True)
class Disable(Request):
    """Bring a drive into its safe state."""

    verb = "disable"

    def apply(self, machine: Machine, _: Moment) -> None:
        """Stop the drive."""
        machine.disable()


@dataclass(frozen=True, slots=True)
class Reset(Request):
    """Leave a trip whose cause is gone."""

    verb = "reset"

    def apply(self, machine: Machine, now: Moment) -> None:
        """Reset the trip."""
        machine.reset(now.cause)


@dataclass(frozen=True, slots=True)
class Reload(Request):
    """Take the load and the limits of the file, between two runs.

    Attributes:
        measured: SHA-256 of the file whose model was measured: the estimates start from it. The
            daemon refuses where its own file is another one. None for no such file.
    """

    verb = "reload"
    measured: str | None = None

    def apply(self, machine: Machine, _: Moment) -> None:
        """Refuse it unless the drive is off, as confirmed."""
        if machine.state is not State.STANDBY:
            raise RefusedError(f"reload needs standby; state is {machine.state}")


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

    def trip(self, cause: str) -> None:
        """Trip at once for a cause outside the drive; the first cause stays until `reset`."""

    def stop(self) -> State:
        """Bring the drive into its safe state at once, in every state and at any time.

        It neither waits nor refuses.

        Returns:
            The state after it.
        """
