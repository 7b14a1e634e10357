"""The program of a drive: its steps become requests, one after another, between two ticks.

A program needs an enabled drive and never enables one. Whatever commands the drive off ends it
where it is, and nothing takes it up again.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import msgspec

from adaptdrive.config.load import LoadSection
from adaptdrive.config.section import same_unit
from adaptdrive.control.signals import Mode, Waveform
from adaptdrive.runtime import requests
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import End, Program, Step, Turn
from adaptdrive.runtime.settings import AskedReference, MachineLimits, require_positive
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.util.errors import RefusedError
from adaptdrive.util.quantity import Display

_BY_HAND = requests.SetSetpoint | requests.SetWaveform | requests.SetMode | requests.SetVoltage
"""Requests that would move what a program moves."""


def _order_of(step: Step) -> requests.Request:
    """Return the request that a step begins with."""
    match step:
        case requests.RampTo(to, slope):
            return requests.SetSetpoint(to, slope)
        case requests.WaveFor():
            return requests.SetWaveform(step.waveform)
        case requests.Choose(mode):
            return requests.SetMode(Mode(mode))
        case _:
            return requests.SetWaveform(None)


def _described(step: Step, display: Display) -> str:
    """Return what a step does, in words."""
    match step:
        case requests.RampTo(to, slope):
            way = "" if slope is None else f" at {display.change.text(slope)}/s"
            return f"ramp to {display.text(to)}{way}"
        case requests.HoldFor(for_s, within):
            near = "" if within is None else f" until within {display.change.text(within)}"
            return f"hold{near} for {for_s:g} s"
        case requests.WaveFor(shape, low, high, period_s, for_s):
            levels = f"{display.shown(low):g} to {display.text(high)}"
            return f"{shape} {levels}, period {period_s:g} s, for {for_s:g} s"
        case requests.Choose(mode):
            return f"mode {mode}"


def _level_after(step: Step, level: float) -> float:
    """Return the reference after a step that begins at a level."""
    match step:
        case requests.RampTo(to):
            return to
        case requests.WaveFor():
            return step.waveform.value(step.for_s)
        case _:
            return level


@dataclass(slots=True)
class _Run:
    """A program and where it is.

    Attributes:
        program: What runs.
        number: Its present step, from 0.
        since_tick: Since when its time counts, later by each pause.
        held: Tick of the pause, and the reference that goes on after it; None while it runs.
        reason: Why it has ended; empty before.
    """

    program: Program
    number: int = 0
    since_tick: int = 0
    held: tuple[int, AskedReference] | None = None
    reason: str = ""

    @property
    def step(self) -> Step:
        """The present step."""
        return self.program.steps[self.number]

    @property
    def status(self) -> Literal["running", "paused", "ended"]:
        """Whether it goes on."""
        if self.reason:
            return "ended"
        return "running" if self.held is None else "paused"


class Programs:
    """Runs one program at a time on a state machine.

    Attributes:
        machine: State and requests of the drive.
    """

    def __init__(self, machine: Machine, limits: MachineLimits) -> None:
        """Begin without a program.

        Args:
            machine: State and requests of the drive.
            limits: Of requests.
        """
        self.machine, self._limits = machine, limits
        self._tick_s = limits.drive.half_cycle_s
        self._run: _Run | None = None

    @property
    def report(self) -> requests.ProgramReport | None:
        """The program that runs, or has run last."""
        self._active()
        if (run := self._run) is None:
            return None
        name, step, steps = run.program.name, run.number + 1, len(run.program.steps)
        does = _described(run.step, self._limits.load.display)
        status = f"{run.status}: {run.reason}" if run.reason else run.status
        text = f"{name} {status}, step {step} of {steps}: {does}"
        return requests.ProgramReport(name, step, steps, run.status, run.reason, text)

    def remaining_s(self, tick: int) -> float | None:
        """Return the least time to the end of the program that runs, None without one."""
        if (run := self._active()) is None:
            return None
        least_s, level = 0.0, self.machine.reference(tick)
        for step in run.program.steps[run.number :]:
            if isinstance(step, requests.RampTo):
                least_s += abs(step.to - level) / self._limits.slope(step.slope)
            elif not isinstance(step, requests.Choose):
                least_s += step.for_s
            level = _level_after(step, level)
        if isinstance(run.step, requests.HoldFor | requests.WaveFor):
            now = tick if run.held is None else run.held[0]
            least_s -= (now - run.since_tick) * self._tick_s
        return max(0.0, least_s)

    def refuse_by_hand(self, request: requests.Request) -> None:
        """Refuse what would move the reference of a program, while one runs or is paused.

        Raises:
            RefusedError: As above.
        """
        if isinstance(request, _BY_HAND) and (run := self._active()) is not None:
            name = run.program.name
            raise RefusedError(f"program {name!r} is {run.status}: stop it before {request.verb}")

    def carry_out(self, request: requests.RunProgram, tick: int, output: float) -> None:
        """Check and start a program, or turn the one that runs.

        Args:
            request: What is asked.
            tick: Present tick.
            output: Present output, NaN while unknown.

        Raises:
            RefusedError: It cannot be done; nothing was changed.
        """
        asked = request.value
        if isinstance(asked, Program):
            self._check(asked)
            self._start(asked, tick, output)
        elif (run := self._active()) is None:
            raise RefusedError("no program runs")
        else:
            self._turn(run, asked, tick, output)

    def progress(self, tick: int, output: float) -> bool:
        """Go on to the next step where the present one is over; return whether it is.

        Args:
            tick: Present tick.
            output: Present output.
        """
        changed = False
        while (run := self._active()) is not None and self._is_over(run, tick, output):
            self._go_on(run, tick, output)
            changed = True
        return changed

    def _active(self) -> _Run | None:
        """Return the program that runs or is paused; one of a drive that is off has ended."""
        run = self._run
        if run is None or run.reason:
            return None
        if not self.machine.energised:
            run.reason = "tripped" if self.machine.state is State.TRIPPED else "disabled"
            return None
        return run

    def _check(self, program: Program) -> None:
        """Refuse a program with the first step that cannot be carried out."""
        for number, step in enumerate(program.steps, 1):
            try:
                self._require(step)
            except RefusedError as problem:
                raise RefusedError(f"step {number}: {problem.reason}") from problem

    def _require(self, step: Step) -> None:
        reach = self.machine.reach
        match step:
            case requests.RampTo(to, slope):
                self._limits.require_setpoint("ramp to", to, reach)
                require_positive("slope", slope)
            case requests.HoldFor(for_s, within):
                require_positive("for_s", for_s)
                require_positive("within", within)
            case requests.WaveFor():
                self._limits.require_waveform("waveform", step.waveform, reach)
                require_positive("for_s", step.for_s)

    def _start(self, program: Program, tick: int, output: float) -> None:
        if (active := self._active()) is not None:
            raise RefusedError(f"program {active.program.name!r} is {active.status}: stop it first")
        self.machine.require_loop("program")
        run = _Run(program)
        self._begin_step(run, tick, output)
        self._run = run

    def _turn(self, run: _Run, turn: Turn, tick: int, output: float) -> None:
        if turn is Turn.RESUME:
            self._resume(run, tick)
        elif turn is Turn.PAUSE and run.held is None:
            run.held = tick, self.machine.asked
            self._hold(tick, output)
        elif turn is Turn.SKIP:
            run.held = None
            self._go_on(run, tick, output)
        elif turn is Turn.STOP:
            run.reason = "stopped"
            self._hold(tick, output)

    def _resume(self, run: _Run, tick: int) -> None:
        """Go on with the reference where it was: its begin moves by the pause."""
        if run.held is None:
            return
        paused_tick, asked = run.held
        self.machine.asked = asked.later(tick - paused_tick)
        run.since_tick += tick - paused_tick
        run.held = None

    def _hold(self, tick: int, output: float) -> None:
        self.machine.carry_out(requests.SetWaveform(None), tick, output, None)

    def _go_on(self, run: _Run, tick: int, output: float) -> None:
        """Begin the next step, or end the program; a step that is refused by now ends it too."""
        try:
            if run.number + 1 < len(run.program.steps):
                run.number += 1
                self._begin_step(run, tick, output)
            else:
                run.reason = "complete"
                self._end(run.program.end, tick, output)
        except RefusedError as problem:
            run.reason = problem.reason
            self._hold(tick, output)

    def _begin_step(self, run: _Run, tick: int, output: float) -> None:
        self.machine.carry_out(_order_of(run.step), tick, output, None)
        run.since_tick = tick

    def _end(self, end: End, tick: int, output: float) -> None:
        if end is End.DISABLE:
            self.machine.disable()
        elif end is End.REST:
            self.machine.asked = AskedReference(0.0)
            self.machine.coast()
        else:
            self._hold(tick, output)

    def _is_over(self, run: _Run, tick: int, output: float) -> bool:
        machine, step = self.machine, run.step
        runs = machine.state is State.RUNNING
        if run.held is not None:
            return False
        if isinstance(step, requests.Choose):
            return True
        if isinstance(step, requests.RampTo):
            return machine.asked.ramp is None and runs
        if isinstance(step, requests.HoldFor) and step.within is not None:
            near = runs and abs(output - machine.reference(tick)) <= step.within
            run.since_tick = run.since_tick if near else tick
        return tick - run.since_tick >= math.ceil(step.for_s / self._tick_s)


# Requests in the unit in which people see the output.

_ROUNDING = 1e-9
"""Share of the set-point range by which a limit that is converted there and back may be off."""

Convert = Callable[[float], float]


def in_own_unit(request: requests.Request, load: LoadSection) -> requests.Request:
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
        case requests.SetSetpoint(value, slope):
            return requests.SetSetpoint(level(value), slope and change(slope))
        case requests.SetWaveform(Waveform() as wave, preview):
            wave = dataclasses.replace(wave, low=level(wave.low), high=level(wave.high))
            return requests.SetWaveform(wave, preview)
        case requests.RunProgram(requests.Program() as program):
            steps = tuple(_converted(step, level, change) for step in program.steps)
            return requests.RunProgram(msgspec.structs.replace(program, steps=steps))
    return request


def _display_of(request: requests.Request, load: LoadSection) -> Display:
    """Return the unit that a request is in."""
    held = request.value if isinstance(request, requests.RunProgram) else request
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


def _converted(step: requests.Step, level: Convert, change: Convert) -> requests.Step:
    match step:
        case requests.RampTo(to, slope):
            return requests.RampTo(level(to), slope and change(slope))
        case requests.HoldFor(for_s, within):
            return requests.HoldFor(for_s, within and change(within))
        case requests.WaveFor(_, low, high):
            return msgspec.structs.replace(step, low=level(low), high=level(high))
    return step
