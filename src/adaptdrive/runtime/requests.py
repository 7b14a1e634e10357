"""Requests of an operator to a running drive: the registry of all commands, and programs.

A request is one class: its verb in the topic, and its fields as they stand in the payload. The
state machine carries it out. `REQUESTS` lists them; messages and command line are made of it.
"""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, ClassVar, Literal

import msgspec

from adaptdrive.config.load import LoadSection
from adaptdrive.config.section import same_unit
from adaptdrive.control.signals import Mode, Shape, Waveform
from adaptdrive.util.errors import RefusedError
from adaptdrive.util.quantity import Display

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
    """Hold the present reference for a time in s."""

    for_s: float


class Settle(_Step, frozen=True, tag="settle"):
    """Hold the present reference until each reading has been near it.

    Attributes:
        within: Largest distance, in the unit of the output.
        for_s: For so long without a break.
    """

    within: float
    for_s: float


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


Step = RampTo | HoldFor | Settle | WaveFor | Choose


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
        does: What this step does.
        status: Whether it goes on.
        reason: Why it has ended; empty before.
        end: What follows its last step: hold, rest or disable.
    """

    name: str
    step: int
    steps: int
    does: str
    status: Literal["running", "paused", "ended"]
    reason: str
    end: str

    def __str__(self) -> str:
        status = f"{self.status}: {self.reason}" if self.reason else self.status
        return f"{self.name} {status}, step {self.step} of {self.steps}: {self.does}"


@dataclass(frozen=True, slots=True)
class ProgramTimes:
    """What is left of the program that runs; a step that waits for the output may take longer.

    Attributes:
        step_s: Least time to the end of the present step.
        program_s: The same to the end of the program.
    """

    step_s: float
    program_s: float


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
        check: Whether a program is checked only.
    """

    verb = "program"
    value: Program | Turn
    check: bool = False


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


# Requests in the unit in which people see the output.

_ROUNDING = 1e-9
"""Share of the set-point range by which a limit that is converted there and back may be off."""

Convert = Callable[[float], float]


def in_own_unit(request: Request, load: LoadSection) -> Request:
    """Return a request with its values in the unit of the output.

    Args:
        request: What is asked.
        load: Units and limits of the output.

    Raises:
        RefusedError: It is in another unit.
    """
    display = _display_of(request, load)
    if display == Display(load.output_unit):
        return request
    level, change = functools.partial(_level, load, display), display.change.typed
    match request:
        case SetSetpoint(value, slope):
            return SetSetpoint(level(value), slope and change(slope))
        case SetWaveform(Waveform() as wave, preview):
            wave = dataclasses.replace(wave, low=level(wave.low), high=level(wave.high))
            return SetWaveform(wave, preview)
        case RunProgram(Program() as program, check):
            steps = tuple(_converted(step, level, change) for step in program.steps)
            return RunProgram(msgspec.structs.replace(program, steps=steps), check)
    return request


def _display_of(request: Request, load: LoadSection) -> Display:
    """Return the unit that a request is in."""
    held = request.value if isinstance(request, RunProgram) else request
    unit: str | None = getattr(held, "unit", None)
    for display in (load.display, Display(load.output_unit)):
        if unit is not None and same_unit(unit, display.unit):
            return display
    if unit is None:
        return Display(load.output_unit)
    units = dict.fromkeys((load.display.unit, load.output_unit))
    raise RefusedError(f"unit = {unit!r}: the output is in {' or '.join(units)}")


def _level(load: LoadSection, display: Display, value: float) -> float:
    """Return a level in the unit of the output; a limit that was typed is met exactly."""
    found, near = display.typed(value), _ROUNDING * (load.reference_max - load.reference_min)
    limits = (load.reference_min, load.reference_max)
    return next((limit for limit in limits if abs(found - limit) <= near), found)


def _converted(step: Step, level: Convert, change: Convert) -> Step:
    match step:
        case RampTo(to, slope):
            return RampTo(level(to), slope and change(slope))
        case Settle(within):
            return msgspec.structs.replace(step, within=change(within))
        case WaveFor(_, low, high):
            return msgspec.structs.replace(step, low=level(low), high=level(high))
    return step
