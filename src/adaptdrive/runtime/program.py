"""The program of a drive: its steps become requests, one after another, between two ticks.

A program needs an enabled drive and never enables one. Whatever commands the drive off ends it
where it is, and nothing takes it up again.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeVar

from adaptdrive.control.signals import Mode, Waveform
from adaptdrive.runtime import requests
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import End, Program, Step, Turn
from adaptdrive.runtime.settings import AskedReference, MachineLimits, require_positive
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.util.errors import RefusedError
from adaptdrive.util.quantity import Display

T = TypeVar("T")

_BY_HAND = (
    requests.SetSetpoint,
    requests.SetWaveform,
    requests.SetMode,
    requests.SetVoltage,
)
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
        case requests.HoldFor(for_s):
            return f"hold for {for_s:g} s"
        case requests.Settle(within, for_s):
            return f"hold until within {display.change.text(within)} for {for_s:g} s"
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


def _refusal(require: Callable[[str, T], None], what: str, value: T) -> Iterator[str]:
    """Yield the reason for which a value is refused, if it is."""
    try:
        require(what, value)
    except RefusedError as problem:
        yield problem.reason


@dataclass(slots=True)
class _Run:
    """A program and where it is.

    Attributes:
        program: What runs.
        number: Its present step, from 0.
        began_tick: When that step began, later by each pause.
        near_tick: Since when the output has been near the reference.
        after_s: Least time of the steps that follow.
        held: Tick of the pause, and the reference that goes on after it; None while it runs.
        reason: Why it has ended; empty before.
    """

    program: Program
    number: int = 0
    began_tick: int = 0
    near_tick: int = 0
    after_s: float = 0.0
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
        return requests.ProgramReport(
            name=run.program.name,
            step=run.number + 1,
            steps=len(run.program.steps),
            does=_described(run.step, self._limits.load.display),
            status=run.status,
            reason=run.reason,
            end=run.program.end,
        )

    def remaining(self, tick: int) -> requests.ProgramTimes | None:
        """Return what is left of the program that runs, None without one."""
        if (run := self._active()) is None:
            return None
        now = tick if run.held is None else run.held[0]
        match run.step:
            case requests.Choose():
                left_s = 0.0
            case requests.RampTo():
                left_s = self._way_s(run.step, self.machine.reference(tick))
            case requests.Settle(_, for_s):
                left_s = for_s - (now - run.near_tick) * self._tick_s
            case requests.HoldFor(for_s) | requests.WaveFor(for_s=for_s):
                left_s = for_s - (now - run.began_tick) * self._tick_s
        left_s = max(0.0, left_s)
        return requests.ProgramTimes(left_s, left_s + run.after_s)

    def refuse_by_hand(self, request: requests.Request) -> None:
        """Refuse what would move the reference of a program, while one runs or is paused.

        Raises:
            RefusedError: As above.
        """
        if isinstance(request, _BY_HAND) and (run := self._active()) is not None:
            name = run.program.name
            raise RefusedError(f"program {name!r} is {run.status}: stop it before {request.verb}")

    def carry_out(self, request: requests.RunProgram, tick: int, output: float) -> None:
        """Check or start a program, or turn the one that runs.

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
            if not request.check:
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
        """Refuse a program with the reason of every step that cannot be carried out."""
        reasons = [
            reason
            for number, step in enumerate(program.steps, 1)
            for reason in self._flaws(f"step {number}:", step)
        ]
        if reasons:
            raise RefusedError("; ".join(reasons))

    def _flaws(self, place: str, step: Step) -> Iterator[str]:
        match step:
            case requests.RampTo(to, slope):
                yield from _refusal(self._require_setpoint, f"{place} ramp to", to)
                yield from _refusal(require_positive, f"{place} slope", slope)
            case requests.Settle(within):
                yield from _refusal(require_positive, f"{place} within", within)
            case requests.WaveFor():
                yield from _refusal(self._require_waveform, f"{place} waveform", step.waveform)
        if isinstance(step, requests.HoldFor | requests.Settle | requests.WaveFor):
            yield from _refusal(require_positive, f"{place} for_s", step.for_s)

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
        run.began_tick += tick - paused_tick
        run.near_tick += tick - paused_tick
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
        level = _level_after(run.step, self.machine.reference(tick))
        self.machine.carry_out(_order_of(run.step), tick, output, None)
        run.began_tick = run.near_tick = tick
        run.after_s = self._least_s(run.program.steps[run.number + 1 :], level)

    def _end(self, end: End, tick: int, output: float) -> None:
        if end is End.DISABLE:
            self.machine.disable()
        elif end is End.REST:
            self.machine.asked = AskedReference(0.0)
            self.machine.coast()
        else:
            self._hold(tick, output)

    def _is_over(self, run: _Run, tick: int, output: float) -> bool:
        machine = self.machine
        if run.held is not None:
            return False
        match run.step:
            case requests.Choose():
                return True
            case requests.RampTo():
                return machine.asked.ramp is None and machine.state is State.RUNNING
            case requests.Settle(within, for_s):
                error, runs = output - machine.reference(tick), machine.state is State.RUNNING
                if not (runs and abs(error) <= within):
                    run.near_tick = tick
                return self._passed(tick - run.near_tick, for_s)
            case requests.HoldFor(for_s) | requests.WaveFor(for_s=for_s):
                return self._passed(tick - run.began_tick, for_s)

    def _passed(self, ticks: int, time_s: float) -> bool:
        return ticks >= math.ceil(time_s / self._tick_s)

    def _way_s(self, ramp: requests.RampTo, level: float) -> float:
        return abs(ramp.to - level) / self._limits.slope(ramp.slope)

    def _least_s(self, steps: tuple[Step, ...], level: float) -> float:
        """Return the least time of steps that begin at a level."""
        least_s = 0.0
        for step in steps:
            if isinstance(step, requests.RampTo):
                least_s += self._way_s(step, level)
            elif not isinstance(step, requests.Choose):
                least_s += step.for_s
            level = _level_after(step, level)
        return least_s

    def _require_setpoint(self, what: str, value: float) -> None:
        self._limits.require_setpoint(what, value, self.machine.reach)

    def _require_waveform(self, what: str, waveform: Waveform) -> None:
        self._limits.require_waveform(what, waveform, self.machine.reach)
