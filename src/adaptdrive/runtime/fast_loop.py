"""The fast loop: one tick per half line cycle, clocked by the drive's own status frame.

A frame runs its tick at once. When a frame is late, the timer runs a stand-in tick on the held
values; the frame, if it still comes, then replaces those values and makes no second tick. Whatever
goes wrong, every tick sends a command, and without a reason to do otherwise it is the safe one.

Within a tick the command comes first. What can wait until it is on the wire (the timer, the slow
loop, the watchdog, the counts and the report) comes after it.
"""

import math
from collections import deque
from typing import Final

from adaptdrive.config.consistency import LATE_READINGS
from adaptdrive.control import signals
from adaptdrive.control.schedule import Schedule, TwoRate
from adaptdrive.devices.port import Port
from adaptdrive.runtime import reports, state_machine, stopping, timebase
from adaptdrive.runtime.settings import FastLoopSettings, LoopServices
from adaptdrive.safety.facts import Reading, assuming
from adaptdrive.safety.guard import CapacitorBalance, Guard
from adaptdrive.safety.interlocks import InterlockBoard
from adaptdrive.safety.trips import Trip, TripKind

_OFF: Final[signals.Stage] = signals.Stage.OFF  # found at once by compiled code
_PRECHARGE: Final[signals.Stage] = signals.Stage.PRECHARGE
_RUN: Final[signals.Stage] = signals.Stage.RUN


_LONGEST = 4096
"""Times kept between two reports: 34 s at 120 Hz."""


class TimeWindow:
    """Collects times: gives their quantiles once, and counts them for ever."""

    def __init__(self) -> None:
        self._times_us: deque[float] = deque(maxlen=_LONGEST)
        self._counts = [0] * timebase.BINS

    @property
    def histogram(self) -> tuple[int, ...]:
        """Counts of all times so far, by bin."""
        counts = self._counts.copy()
        for time_us in self._times_us:
            counts[timebase.bin_of(time_us)] += 1
        return tuple(counts)

    def add(self, time_us: float) -> None:
        """Take in one time in microseconds; it is counted later, outside the tick."""
        times = self._times_us
        if len(times) == _LONGEST:
            self._counts[timebase.bin_of(times[0])] += 1
        times.append(time_us)

    def take(self) -> timebase.Quantiles:
        """Quantiles of the times since the last call; NaN when there were none."""
        self._counts = list(self.histogram)
        times = sorted(self._times_us)
        self._times_us.clear()
        if not times:
            return timebase.NO_TIMES
        last = len(times) - 1
        return timebase.Quantiles(times[round(0.50 * last)], times[round(0.99 * last)], times[last])


class FastLoop:
    """Runs the ticks of one drive. Listens to the port; is called by the timer.

    Attributes:
        tick: Latest tick, -1 before the first.
        stopping: A stop on its way, and its confirmation by the drive.
        stop_limit_s: Longest time from a stop to its confirmation.
        reading: Latest reading.
        measurement: That of the latest tick.
        command: Last command that was given to the port.
        guard: Holds the commands to their limits.
        ticks: Ticks run.
        missed: Half cycles that passed without a tick.
        held: Stand-in ticks.
        withheld: Commands that were not given to the port: the drive must report first.
        lateness: Times from due to begun.
        turnaround: Times from a frame to its command.
        tick_time: Times that ticks took.
    """

    def __init__(
        self,
        port: Port,
        controller: TwoRate,
        machine: state_machine.Machine,
        settings: FastLoopSettings,
        surroundings: LoopServices,
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
        timing = settings.timing
        self._stride = timing.ticks_per_reading
        self._half_cycles = timebase.HalfCycles(
            port.counter_modulus, timing.half_cycle_s, self._stride, timing.stale_s
        )
        self.guard = Guard(settings.drive)
        highest_V = settings.limits.boost_voltage_max_V
        charges = settings.charges_capacitor
        self._capacitor = CapacitorBalance(settings.drive, highest_V) if charges else None
        self._assumes_voltage = "boost_voltage_V" in settings.limits.absent
        self._surroundings = surroundings
        counts, rate = self._half_cycles.counts, self._half_cycles.rate
        watches = [build() for build in settings.watches]
        clocks = rate if settings.drive_clocks else None
        self._interlocks = InterlockBoard(settings.limits, timing, watches, port, counts, clocks)
        self.stopping = stopping.Stopping(port, timing, machine, surroundings.not_stopped)
        self._order: signals.Order | None = None
        self._wanted = signals.SAFE_COMMAND
        self._waits = False
        self._sequence = 0
        self._deadline_s = math.inf
        self.tick = -1
        self.stop_limit_s: Final = self.stopping.watch.limit_s
        self.reading: Reading | None = None
        self.measurement: signals.Measurement | None = None
        self.command = signals.SAFE_COMMAND
        self.ticks = self.missed = self.held = self.withheld = 0
        self.lateness = TimeWindow()
        self.turnaround = TimeWindow()
        self.tick_time = TimeWindow()

    @property
    def cause(self) -> Trip | None:
        """The interlock that is active now; the fault of the port comes first.

        A drive that is commanded off and has its bridge on must not be enabled or reset.
        """
        reading = self.reading
        cause = self._interlocks.standing_cause(reading, self._surroundings.now_s())
        if cause or self._machine.energised or reading is None or not reading.bridge:
            return cause
        text = "the drive's bridge is on although it is commanded off"
        return Trip(TripKind.SWITCHED_ON, text)

    def begin(self) -> None:
        """Start the stand-in timer; the first frame takes over from it."""
        self._arm(self._surroundings.now_s() + self._half_cycles.reading_period_s)

    def on_reading(self, reading: Reading) -> None:
        """Run the tick of a complete reading, unless a stand-in already did."""
        half_cycles, arrival_s = self._half_cycles, reading.arrival_s
        tick = half_cycles.place(reading.counter, arrival_s, self.tick)
        if self._assumes_voltage:
            reading = assuming(reading, self.command.boost_reference_V)
        self.reading = reading
        if tick > self.tick:
            self._run(tick, arrival_s, self._surroundings.now_s(), fresh=reading.whole)
        else:
            self._watch_late_reading(reading, self._surroundings.now_s())
        self._arm(arrival_s + LATE_READINGS * half_cycles.reading_period_s)

    def _watch_late_reading(self, reading: Reading, now_s: float) -> None:
        """Trip for a reading beyond a limit, or of a drive that has stopped, now.

        The next one may replace it before a tick, and its report of a bridge that is to be on.
        """
        driven = self.command.bridge
        if driven or self._interlocks.standing_cause(reading, now_s) is not None:
            self._watch_interlocks(now_s)
            if not self._machine.energised:
                self.send_safe()
        if self._is_wanted_still() and not self._interlocks.awaits_bridge(now_s):
            self._send_in_time(self._wanted)

    def _is_wanted_still(self) -> bool:
        """Return whether this tick's command waits for a report, in the stage it was decided in."""
        return self._waits and self._order is not None and self._order.stage is self._machine.stage

    def on_deadline(self, deadline_s: float) -> None:
        """Run a stand-in tick on the held values: no frame came in time.

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
        self.held += 1
        tick = self._half_cycles.following(self.tick, skipped)
        self._run(tick, deadline_s, now_s, fresh=False)

    def _judge(self, due_s: float, ended_s: float) -> None:
        """Notify the watchdog when a tick was complete within half a period of its time.

        A frame that waited while the loop overslept its deadline was due at that deadline, however
        fast its own tick was.
        """
        if ended_s - due_s < 0.5 * self._half_cycles.reading_period_s:
            self._surroundings.met_deadline(ended_s)

    def deliver(self, snapshot: signals.Snapshot, decision: signals.Decision) -> None:
        """Take a decision of the slow loop; it takes effect at its fixed tick."""
        if self._machine.stage is signals.Stage.RUN and self._schedule.deliver(snapshot, decision):
            self._surroundings.decided(snapshot, decision)

    def send_safe(self) -> None:
        """Send the safe command now, outside any tick, to a drive that is commanded off."""
        if self.command.bridge:  # the last tick may have been the first to command it on
            self.stopping.release(self.reading, bridge=True)
        self.command = self.guard.check(signals.SAFE_COMMAND)
        self._port.send(self.command)
        self.stopping.judge(self.reading, self._surroundings.now_s())

    def _send(self, command: signals.Command) -> None:
        """Guard, then wire; what neither can pass trips the drive instead of the daemon."""
        capacitor = self._capacitor
        if capacitor is not None:
            command = capacitor.bound(command)
        try:
            self.command = self.guard.check(command)
            self._port.send(self.command)
            if capacitor is not None:
                capacitor.sent(self.command.current_scale_S)
        except ValueError as problem:
            finite = math.isfinite(command.current_scale_S + command.boost_reference_V)
            kind = TripKind.COMMAND_UNFIT if finite else TripKind.GAIN_NOT_FINITE
            self._machine.latch(Trip(kind, f"command cannot be sent: {problem}"))
            self.send_safe()

    def _arm(self, deadline_s: float) -> None:
        self._deadline_s = deadline_s
        self._surroundings.arm(deadline_s)

    def _run(self, tick: int, due_s: float, began_s: float, *, fresh: bool) -> None:
        """One tick: first the command, then what can wait for it."""
        passed = tick - self.tick if self.tick >= 0 else 0
        self.tick = tick
        self._watch_interlocks(began_s)
        self._watch_capacitor(max(passed, 1))
        if self.reading is None:
            self.send_safe()
        else:
            self._control(tick, self.reading, fresh=fresh)
        ended_s = self._surroundings.now_s()
        self._hand_over_snapshot()
        self._judge(min(due_s, self._deadline_s), ended_s)
        self.ticks += 1
        if passed:  # the readings that should have had a tick since the last
            self.missed += passed // self._stride - 1
        self._keep_time(due_s, began_s, ended_s, fresh=fresh)

    def _watch_capacitor(self, ticks: int) -> None:
        """Trip for a boost voltage that the commanded energy contradicts, or leads too high."""
        capacitor, reading = self._capacitor, self.reading
        if capacitor is None:
            return
        if reading is None or not self._machine.energised or self._machine.stage is _OFF:
            capacitor.forget()
            return
        tick_s, running = self._half_cycles.tick_period_s, self._machine.stage is _RUN
        cause = capacitor.find_cause(reading, ticks, tick_s, running=running)
        if cause is not None:
            self._machine.latch(cause)

    def _hand_over_snapshot(self) -> None:
        """Give the slow loop its snapshot; the safe command replaces this tick's if that trips."""
        snapshot = self._schedule.take_snapshot()
        if snapshot is not None and not self._surroundings.snapshot_taken(snapshot):
            text = "slow loop: no decision for three slow periods"
            self._machine.latch(Trip(TripKind.SLOW_LOOP, text))
            self.send_safe()

    def _keep_time(self, due_s: float, began_s: float, ended_s: float, *, fresh: bool) -> None:
        lateness_us, tick_us = (began_s - due_s) * 1e6, (ended_s - began_s) * 1e6
        turnaround_us = (ended_s - due_s) * 1e6 if fresh else math.nan
        self.lateness.add(lateness_us)
        self.tick_time.add(tick_us)
        if fresh:
            self.turnaround.add(turnaround_us)
        if self.measurement is None or self._order is None:
            return
        report = reports.TickReport(
            sequence=self._sequence,
            measurement=self.measurement,
            order=self._order,
            applied_k=self._schedule.applied_k,
            command=self._wanted,
            lateness_us=lateness_us,
            turnaround_us=turnaround_us,
            tick_us=tick_us,
            time_s=ended_s,
        )
        self._sequence += 1
        self._surroundings.ticked(report)

    def _watch_interlocks(self, now_s: float) -> None:
        machine, reading, board = self._machine, self.reading, self._interlocks
        stage = machine.stage
        if stage is _OFF or (stage is _PRECHARGE and not self.command.bridge):
            self.stopping.judge(reading, now_s)
        else:
            self.stopping.release(reading, bridge=self.command.bridge)
        if not machine.energised:
            board.look(now_s)
            return
        running, bridge = stage is _RUN, self.command.bridge
        cause = board.running_cause(reading, now_s, running=running, bridge=bridge)
        if cause is not None:
            machine.latch(cause)
            self.stopping.watch.command(now_s)
        else:
            unknown_rate = board.unknown_rate(now_s)
            voltage_V = math.nan if reading is None else reading.boost_voltage_V
            machine.advance(self.tick, voltage_V, unknown_rate=unknown_rate, now_s=now_s)
            if stage is _OFF and machine.stage is not _OFF:
                self.stopping.start()

    def _control(self, tick: int, reading: Reading, *, fresh: bool) -> None:
        order = self._machine.order(tick)
        if order is not self._order and order.stage is not _RUN:
            self._surroundings.run_ended()
        self._order = order
        measurement = signals.Measurement(
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
        self._send_in_time(command)

    def _send_in_time(self, command: signals.Command) -> None:
        """Send the command of this tick; one that energises waits for a report that is due.

        A later reading of the same tick may bring that report.
        """
        self._waits = False
        if self._overslept():
            self.send_safe()
            return
        if command.bridge and self._interlocks.awaits_bridge(self._surroundings.now_s()):
            self._waits = True
            self.withheld += 1
            return
        self._send(command)
        if self._overslept(sent=command.bridge):  # between that look at the clock and the bus
            self.send_safe()

    def _overslept(self, *, sent: bool = False) -> bool:
        """Return whether this tick was kept from running for so long that its command is void.

        Args:
            sent: Whether a command that energises may have been sent after that time.
        """
        machine, board, now_s = self._machine, self._interlocks, self._surroundings.now_s()
        if not machine.energised:
            return False
        cause = board.gap_cause(now_s) or (board.late_command_cause(now_s) if sent else None)
        if cause is not None:
            machine.latch(cause)
        return cause is not None
