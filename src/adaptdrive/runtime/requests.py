"""Requests of an operator to a running drive: the registry of all commands, and programs.

A request is one class: its verb in the topic, and its fields as they stand in the payload. The
state machine carries it out. `REQUESTS` lists them; messages and command line are made of it.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, ClassVar, Literal

import msgspec

from adaptdrive.control.signals import Mode, Shape, Waveform

# Programs of set-points, as they come in a payload and stand in a file.


class _Step(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="do"):
    """A step of a program; `do` names its kind."""


class RampTo(_Step, frozen=True, tag="ramp"):
    """Go to a set-point.

    Attributes:
        to: The set-point.
        slope: Change of the reference in one second; None for `load.reference_slope`.
    """

    to: float
    slope: float | None = None


class HoldFor(_Step, frozen=True, tag="hold"):
    """Hold the present reference for a time.

    Attributes:
        for_s: The time.
        within: Largest distance of each reading from it, in the unit of the output: the time begins
            anew where one is farther. None for any.
    """

    for_s: float
    within: float | None = None


class WaveFor(_Step, frozen=True, tag="waveform"):
    """Follow a waveform for a time; its fields are those of a `Waveform`."""

    shape: Shape
    low: float
    high: float
    period_s: float
    for_s: float

    @property
    def waveform(self) -> Waveform:
        """The set-point."""
        return Waveform(self.shape, self.low, self.high, self.period_s)


class Choose(_Step, frozen=True, tag="mode"):
    """Choose the controller."""

    mode: Literal["fixed", "adaptive"]


Step = RampTo | HoldFor | WaveFor | Choose


class End(StrEnum):
    """What follows the last step: the reference stays, the load coasts, or the safe state."""

    HOLD = "hold"
    REST = "rest"
    DISABLE = "disable"


class Program(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Steps that the reference follows one after another.

    Attributes:
        name: Its name for people.
        steps: At most 100.
        end: What follows them.
        unit: Unit of levels, slopes and distances, as that of a set-point.
    """

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
    steps: Annotated[tuple[Step, ...], msgspec.Meta(min_length=1, max_length=100)]
    end: End = End.HOLD
    unit: str | None = None


class Turn(StrEnum):
    """What becomes of the program that runs."""

    PAUSE = "pause"
    RESUME = "resume"
    SKIP = "skip"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class ProgramReport:
    """The program that runs, or has run last.

    Attributes:
        name: Its name.
        step: The present step, from 1.
        steps: Steps that it has.
        status: Whether it goes on.
        reason: Why it has ended; empty before.
        text: All of that with what this step does, in words.
    """

    name: str
    step: int
    steps: int
    status: Literal["running", "paused", "ended"]
    reason: str
    text: str


# The requests.


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
        unit: Unit of both: that of the output, also when None, or that in which people see it.
    """

    verb = "setpoint"
    value: float
    slope: float | None = None
    unit: str | None = None


@dataclass(frozen=True, slots=True)
class SetWaveform(Request):
    """Follow a periodic set-point, or hold the present one (`off`).

    Attributes:
        value: The set-point.
        preview: Whether the controller may move before what comes.
        unit: Unit of its levels, as that of a set-point.
    """

    verb = "waveform"
    value: Waveform | None
    preview: bool = True
    unit: str | None = None


@dataclass(frozen=True, slots=True)
class RunProgram(Request):
    """Run a program of set-points; pause, resume or stop it, or skip a step.

    Attributes:
        value: The program, or what becomes of the one that runs.
    """

    verb = "program"
    value: Program | Turn


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
        RunProgram,
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
