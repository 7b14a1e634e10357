"""The fast loop: one tick per half line cycle, clocked by the drive's own status frame.

A frame runs its tick at once. When a frame is late, the timer runs a stand-in tick on the held
values; the frame, if it still comes, then replaces those values and makes no second tick. Whatever
goes wrong, every tick sends a command, and without a reason to do otherwise it is the safe one.

Within a tick the command comes first. What can wait until it is on the wire (the timer, the slow
loop, the watchdog, the books and the report) comes after it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from adaptdrive.control.schedule import Schedule, TwoRate
from adaptdrive.control.signals import (
    SAFE_COMMAND,
    Command,
    Decision,
    Measurement,
    Order,
    Snapshot,
    Stage,
)
from adaptdrive.hardware.port import Port, Reading
from adaptdrive.runtime.bridge_watch import BridgeWatch
from adaptdrive.runtime.guard import CommandLimits, Guard
from adaptdrive.runtime.half_cycles import HalfCycles
from adaptdrive.runtime.interlocks import Limits, Watch, find_cause
from adaptdrive.runtime.machine import Machine
from adaptdrive.runtime.reports import State, StopWord, TickReport
from adaptdrive.runtime.statistics import TimeWindow
from adaptdrive.runtime.stop_watch import Stop, StopWatch

_GAP_READINGS = 2
"""Readings without a tick that a drive which is read seldom may cost: one may be lost."""


_SWITCHED_ON = (
    "the drive's bridge is on although this daemon did not command it: look for another sender, a "
    "key on its panel, or a drive that restarts by itself"
)


@dataclass(slots=True)
class TickCounts:
    """Counts since the start.

    Attributes:
        ticks: Ticks run.
        missed: Half cycles that passed without a tick.
        held: Stand-in ticks.
        late_decisions: Decisions that were not ready at their tick.
    """

    ticks: int = 0
    missed: int = 0
    held: int = 0
    late_decisions: int = 0


@dataclass(frozen=True, slots=True)
class FastLoopSettings:
    """Settings of the fast loop.

    Attributes:
        limits: Trip levels.
        command: Limits of what may be sent.
        tick_s: Half a line cycle at nominal frequency.
        latency_ticks: L, ticks from a snapshot to the effect of its decision.
        late_fraction: Lateness of a frame, in ticks, at which a stand-in tick runs.
        timer_standin: Whether the timer stands in at all.
        ticks_per_reading: Half cycles from one reading to the next, 1 for a drive that sends
            each. A drive that is polled has one tick for each poll.
        watches: Factories of the watches over the output, in the order of their causes.
        drive_clocks: Whether the drive decides when a reading comes.
        stop_s: Longest time from a stop to the drive's word that its bridge is off.
    """

    limits: Limits
    command: CommandLimits
    tick_s: float
    latency_ticks: int
    late_fraction: float
    timer_standin: bool
    ticks_per_reading: int = 1
    watches: tuple[Callable[[], Watch], ...] = ()
    drive_clocks: bool = True
    stop_s: float = 0.5


class LoopSurroundings(Protocol):
    """Interfaces of the fast loop to the rest of the runtime; every call returns at once."""

    def now_s(self) -> float:
        """Monotonic time."""

    def arm(self, deadline_s: float) -> None:
        """Call `on_deadline` at a monotonic time."""

    def met_deadline(self, now_s: float) -> None:
        """A tick was in time."""

    def ticked(self, report: TickReport) -> None:
        """A tick is complete."""

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        """Queue a snapshot for the slow loop; False when it has fallen hopelessly behind."""

    def decided(self, snapshot: Snapshot, decision: Decision) -> None:
        """A decision was taken over."""

    def not_stopped(self, detail: str) -> None:
        """The drive has not confirmed its stop in time."""

    def run_ended(self) -> None:
        """The drive is no longer running: what was decided for it is void."""


class FastLoop:
    """Runs the ticks of one drive. Listens to the port; is called by the timer."""

    def __init__(
        self,
        port: Port,
        controller: TwoRate,
        machine: Machine,
        settings: FastLoopSettings,
        surroundings: LoopSurroundings,
    ) -> None:
        """Join the pieces.

        Args:
            port: Where readings come from and commands go.
            controller: The two-rate controller.
            machine: The state machine.
            settings: Limits and rates.
            surroundings: Receivers of the loop's reports.
        """
        self._port = port
        self._schedule = Schedule(controller, settings.latency_ticks)
        self._machine = machine
        self._half_cycles = HalfCycles(
            port.counter_modulus, settings.tick_s, settings.ticks_per_reading
        )
        self._guard = Guard(settings.command)
        self._watches = [build() for build in settings.watches]
        self._settings = settings
        self._surroundings = surroundings
        self._bridge = BridgeWatch(settings.tick_s, settings.ticks_per_reading)
        self._stop = StopWatch(
            settings.stop_s, settings.ticks_per_reading * settings.tick_s, port.stop_slack_s
        )
        self.stop = StopWord.AWAITED
        self._watched_s = math.inf
        # a drive that sends seldom leaves the loop nothing to watch between two readings
        self._gap_limit_s = max(
            settings.limits.stale_s,
            _GAP_READINGS * settings.ticks_per_reading * settings.tick_s,
        )
        self._order: Order | None = None
        self._wanted = SAFE_COMMAND
        self._sequence = 0
        self._deadline_s = math.inf
        self.tick = -1
        self.reading: Reading | None = None
        self.measurement: Measurement | None = None
        self.command = SAFE_COMMAND
        self.counts = TickCounts()
        self.lateness = TimeWindow()
        self.turnaround = TimeWindow()
        self.tick_time = TimeWindow()

    @property
    def cause(self) -> str | None:
        """The interlock that is active now; what the drive's protocol says comes first."""
        return self._cause(self._surroundings.now_s()) or self._bridge_cause()

    def _bridge_cause(self) -> str | None:
        """Return why a drive that is commanded off must not be enabled or reset."""
        if self._machine.energised or self.reading is None or not self.reading.bridge:
            return None
        return "the drive's bridge is on although it is commanded off"

    def _cause(self, now_s: float) -> str | None:
        settings, port = self._settings, self._port
        cause = port.complaint or find_cause(self.reading, now_s, settings.limits, port.explain_age)
        return cause or (self._half_cycles.rate.cause if settings.drive_clocks else None)

    @property
    def limited(self) -> int:
        """Commands that were held to a limit since the start."""
        return self._guard.limited

    @property
    def reading_period_s(self) -> float:
        """Time from one reading to the next, as measured."""
        return self._half_cycles.reading_period_s

    def begin(self) -> None:
        """Start the stand-in timer; the first frame takes over from it."""
        self._arm(self._surroundings.now_s() + self._half_cycles.reading_period_s)

    def on_reading(self, reading: Reading) -> None:
        """A complete reading came in: run its tick, unless a stand-in already did."""
        half_cycles, arrival_s = self._half_cycles, reading.arrival_s
        tick = half_cycles.place(reading.counter, arrival_s, self.tick)
        self.reading = reading
        if tick > self.tick:
            self._run(tick, arrival_s, self._surroundings.now_s(), fresh=True)
        late_s = (1.0 + self._settings.late_fraction) * half_cycles.reading_period_s
        self._arm(arrival_s + late_s)

    def on_deadline(self, deadline_s: float) -> None:
        """No frame came in time: run a stand-in tick on the held values.

        A frame that came and could not be looked at yet, because the process did not run, is
        better than a stand-in: it is looked at first.
        """
        armed_s = self._deadline_s
        self._port.catch_up()
        if self._deadline_s != armed_s:
            return
        period_s = self._half_cycles.reading_period_s
        now_s = self._surroundings.now_s()
        skipped = max(0, int((now_s - deadline_s) / period_s))
        self._arm(deadline_s + (1 + skipped) * period_s)
        if not self._settings.timer_standin and self.reading is not None:
            self._watch_silence(now_s)
            self._judge(deadline_s, now_s)
            return
        self.counts.held += 1
        tick = self._half_cycles.following(self.tick, skipped)
        self._run(tick, deadline_s, now_s, fresh=False)

    def _watch_silence(self, now_s: float) -> None:
        """Without stand-in ticks: trip when the drive is silent for too long, and stay alive."""
        self._watch_interlocks(now_s)
        if not self._machine.energised:
            self.send_safe()

    def _judge(self, due_s: float, ended_s: float) -> None:
        """Notify the watchdog when a tick was complete within half a period of its time.

        A frame that waited while the loop overslept its deadline was due at that deadline, however
        fast its own tick was.
        """
        if ended_s - due_s < 0.5 * self._half_cycles.reading_period_s:
            self._surroundings.met_deadline(ended_s)

    def deliver(self, snapshot: Snapshot, decision: Decision) -> None:
        """Take a decision of the slow loop; it takes effect at its fixed tick."""
        if self._machine.stage is Stage.RUN and self._schedule.deliver(snapshot, decision):
            self._surroundings.decided(snapshot, decision)

    def send_safe(self) -> None:
        """Send the safe command now, outside any tick."""
        self.command = self._guard.check(SAFE_COMMAND)
        self._port.send(self.command)
        if not self._machine.energised:
            self.watch_stop(self._surroundings.now_s())

    @property
    def stop_limit_s(self) -> float:
        """Longest time from a stop to its confirmation."""
        return self._stop.limit_s

    def watch_stop(self, now_s: float) -> None:
        """Compare what the drive says of its bridge with the stop that it was commanded."""
        stop, machine, reading = self._stop, self._machine, self.reading
        stop.command(now_s)
        verdict = stop.judge(reading, self._port.safe_s, now_s)
        if verdict is Stop.CONFIRMED:
            machine.confirm_stop()
            confirmable = self._port.stop_slack_s is not None
            self.stop = StopWord.CONFIRMED if confirmable else StopWord.IMPOSSIBLE
        elif verdict is Stop.DENIED:
            machine.doubt_stop()
            self._miss_stop(_SWITCHED_ON)
        elif machine.state is State.STANDBY:
            self._await_first_word(reading, now_s)
        elif verdict is Stop.OVERDUE and self.stop is not StopWord.MISSING:
            why = stop.why_not(reading, self._port.safe_s, now_s)
            self._miss_stop(f"the drive does not stop: {why}")
        elif verdict is Stop.AWAITED:
            self.stop = StopWord.AWAITED

    def _await_first_word(self, reading: Reading | None, now_s: float) -> None:
        """A drive that has not spoken since the start: one that is found on has to stop."""
        if reading is not None and reading.bridge:
            self._stop.doubt(now_s)
            self._machine.doubt_stop()

    def _miss_stop(self, problem: str) -> None:
        """Trip; a drive that had tripped before keeps that cause, and this one is reported too."""
        self.stop = StopWord.MISSING
        if self._machine.state is State.TRIPPED:
            self._surroundings.not_stopped(problem)
        self._machine.latch(problem)

    def _send(self, command: Command) -> None:
        """Guard, then wire; what neither can pass trips the drive instead of the daemon."""
        try:
            self.command = self._guard.check(command)
            self._port.send(self.command)
        except ValueError as problem:
            self._machine.latch(f"command cannot be sent: {problem}")
            self.send_safe()

    def _arm(self, deadline_s: float) -> None:
        self._deadline_s = deadline_s
        self._surroundings.arm(deadline_s)

    def _run(self, tick: int, due_s: float, began_s: float, *, fresh: bool) -> None:
        """One tick: first the command, then what can wait for it."""
        passed = tick - self.tick if self.tick >= 0 else 0
        self.tick = tick
        self._watch_interlocks(began_s)
        if self.reading is None:
            self.send_safe()
        else:
            self._control(tick, self.reading, fresh=fresh)
        ended_s = self._surroundings.now_s()
        self._hand_over_snapshot()
        self._judge(min(due_s, self._deadline_s), ended_s)
        self._count(passed)
        self._keep_time(due_s, began_s, ended_s, fresh=fresh)

    def _hand_over_snapshot(self) -> None:
        snapshot = self._schedule.take_snapshot()
        if snapshot is not None and not self._surroundings.snapshot_taken(snapshot):
            self._machine.latch("slow loop: no decision for three slow periods")

    def _count(self, passed: int) -> None:
        """Count a tick, and the readings that should have had one since the last."""
        self.counts.ticks += 1
        self.counts.late_decisions = self._schedule.late_decisions
        if passed:
            self.counts.missed += passed // self._settings.ticks_per_reading - 1

    def _keep_time(self, due_s: float, began_s: float, ended_s: float, *, fresh: bool) -> None:
        lateness_us, tick_us = (began_s - due_s) * 1e6, (ended_s - began_s) * 1e6
        turnaround_us = (ended_s - due_s) * 1e6 if fresh else math.nan
        self.lateness.add(lateness_us)
        self.tick_time.add(tick_us)
        if fresh:
            self.turnaround.add(turnaround_us)
        self._report(lateness_us, turnaround_us, tick_us, ended_s)

    def _watch_interlocks(self, now_s: float) -> None:
        machine, reading = self._machine, self.reading
        unwatched_s, self._watched_s = now_s - self._watched_s, now_s
        if not machine.energised:
            self.watch_stop(now_s)
            return
        self._stop.release()
        # in `starting` a drive may report its bridge late: there the boost voltage is watched
        commanded = self.command.bridge and machine.stage is Stage.RUN
        cause = (
            self._gap_cause(unwatched_s)
            or self._cause(now_s)
            or self._bridge.find_cause(reading, commanded=commanded, unwatched_s=unwatched_s)
            or self._implausible(reading)
        )
        if cause is not None:
            machine.latch(cause)
            self._stop.command(now_s)
        elif reading is not None and self._rate_known:
            machine.advance(self.tick, reading.boost_voltage_V)

    @property
    def _rate_known(self) -> bool:
        """True once the rate of the drive was judged; at an unknown one it is not energised."""
        return not self._settings.drive_clocks or self._half_cycles.rate.judged

    def _gap_cause(self, unwatched_s: float) -> str | None:
        """The cause of a trip when nothing of this process ran for long."""
        if unwatched_s <= self._gap_limit_s:
            return None
        return (
            f"overslept: the daemon did not run for {unwatched_s * 1e3:.0f} ms, limit "
            f"{self._gap_limit_s * 1e3:g} ms: the machine is overloaded or was suspended; see "
            "[realtime]"
        )

    def _implausible(self, reading: Reading | None) -> str | None:
        """Return why the output cannot be that of the load: its sensor goes on, but lies."""
        cause: str | None = None
        for watch in self._watches:
            if self._machine.stage is not Stage.RUN:
                watch.forget()
            elif reading is not None:
                cause = cause or watch.find_cause(reading)
        return cause

    def _control(self, tick: int, reading: Reading, *, fresh: bool) -> None:
        order = self._current_order(tick)
        measurement = Measurement(
            tick,
            self._half_cycles.tick_period_s,
            reading.boost_voltage_V,
            reading.line_voltage_V,
            reading.load_power_W,
            reading.output,
            fresh,
        )
        command = self._schedule.tick(measurement, order)
        self.measurement = measurement
        self._wanted = command
        if self._overslept():
            self.send_safe()
            return
        self._send(command)
        if self._overslept():  # between that look at the clock and the bus
            self.send_safe()

    def _overslept(self) -> bool:
        """Return whether this tick was kept from running for so long that its command is void."""
        if not self._machine.energised:
            return False
        cause = self._gap_cause(self._surroundings.now_s() - self._watched_s)
        if cause is not None:
            self._machine.latch(cause)
        return cause is not None

    def _current_order(self, tick: int) -> Order:
        """The order of this tick; a new object only when something changed."""
        machine, last = self._machine, self._order
        stage, reference = machine.stage, machine.reference(tick)
        manual_V = machine.manual_V(tick)
        if (
            last is not None
            and last.stage is stage
            and last.reference == reference
            and last.mode is machine.mode
            and last.pole == machine.pole
            and last.manual_V == manual_V
        ):
            return last
        if stage is not Stage.RUN:
            self._surroundings.run_ended()
        self._order = Order(stage, reference, machine.mode, machine.pole, manual_V)
        return self._order

    def _report(
        self, lateness_us: float, turnaround_us: float, tick_us: float, time_s: float
    ) -> None:
        if self.measurement is None or self._order is None:
            return
        self._surroundings.ticked(
            TickReport(
                sequence=self._sequence,
                measurement=self.measurement,
                order=self._order,
                applied_k=self._schedule.applied_k,
                command=self._wanted,
                lateness_us=lateness_us,
                turnaround_us=turnaround_us,
                tick_us=tick_us,
                time_s=time_s,
            )
        )
        self._sequence += 1
