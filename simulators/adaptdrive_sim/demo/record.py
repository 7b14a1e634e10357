"""Everything that was heard since the demonstration began, as view and summary need it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime

from adaptdrive.watch.plot import Mark, PlotPoint
from adaptdrive_sim.demo import heard
from adaptdrive_sim.demo.halves import Halves

TRACE_LENGTH = 10 * 600
SLOW_LENGTH = 3600
EVENTS_KEPT = 50
_LATENESS_REPORTS = 100

Clock = Callable[[], float]


@dataclass(frozen=True, slots=True)
class Counts:
    """Counters of the fast loop at one time."""

    time_s: float
    ticks: int
    missed: int
    held: int


@dataclass(slots=True)
class DemoRecord:
    """Received messages; times are seconds of `clock`.

    Attributes:
        began: When the demonstration began, UTC: earlier messages do not belong to it.
        clock: Monotonic clock.
        connected: Whether the broker can be heard.
        online: Whether the daemon is online.
        state: Last state.
        drive: Last report of the fast loop.
        load: Last slow period.
        truth: Last truth of the simulator.
        events: Last events.
        trips: Every trip.
        first: Counters of the first report under control, None before.
        last: Counters now.
        trace: Speed and reference, ten times a second.
        slow: Speed and reference of the last slow periods.
        slow_periods: Slow periods so far.
        marks: What was done to the drive.
        handovers_V: Hand-over step of each change of controller.
        halves: Overshoot of the half waves.
        lateness: The last reports of lateness.
        caption: What is happening, in words.
        size: What a half wave has to move, where it is no number of disks.
    """

    began: datetime
    clock: Clock
    connected: bool = False
    online: bool = False
    state: heard.StateMessage | None = None
    drive: heard.DriveMessage | None = None
    load: heard.LoadMessage | None = None
    truth: heard.Truth | None = None
    events: deque[heard.EventMessage] = field(default_factory=lambda: deque(maxlen=EVENTS_KEPT))
    trips: list[str] = field(default_factory=list)
    first: Counts | None = None
    last: Counts | None = None
    trace: deque[PlotPoint] = field(default_factory=lambda: deque(maxlen=TRACE_LENGTH))
    slow: deque[PlotPoint] = field(default_factory=lambda: deque(maxlen=SLOW_LENGTH))
    slow_periods: int = 0
    marks: deque[Mark] = field(default_factory=lambda: deque(maxlen=EVENTS_KEPT))
    handovers_V: list[float] = field(default_factory=list)
    halves: Halves = field(default_factory=Halves)
    lateness: deque[heard.QuantilesMessage] = field(
        default_factory=lambda: deque(maxlen=_LATENESS_REPORTS)
    )
    caption: str = ""
    size: int = 0

    @property
    def control(self) -> Counts | None:
        """Time and counters since control began, None before."""
        first, last = self.first, self.last
        if first is None or last is None:
            return None
        return Counts(
            last.time_s - first.time_s,
            last.ticks - first.ticks,
            last.missed - first.missed,
            last.held - first.held,
        )

    @property
    def running(self) -> bool:
        """True if the drive is under control."""
        return self.state is not None and self.state.state == "running"

    @property
    def drive_seen(self) -> bool:
        """True if the daemon receives the drive's frames."""
        return self.drive is not None and self.drive.output is not None

    def hear_state(self, state: heard.StateMessage) -> None:
        """Take a state, unless it is of an earlier daemon."""
        if state.time >= self.began:
            self.state = state

    def hear_drive(self, drive: heard.DriveMessage) -> None:
        """Take a report of the fast loop; the first one of a running drive begins the count."""
        now_s = self.clock()
        self.drive = drive
        self.last = Counts(now_s, drive.ticks, drive.missed, drive.held)
        if self.first is None and self.running:
            self.first = self.last
        if drive.lateness_us.max is not None:
            self.lateness.append(drive.lateness_us)
        if drive.output is not None and self.load is not None:
            controller = self.load.controller if self.running else "off"
            point = PlotPoint(now_s, self.load.reference, drive.output, controller)
            self.trace.append(point)

    def hear_load(self, load: heard.LoadMessage) -> None:
        """Take a slow period, unless it is of an earlier daemon."""
        if load.time < self.began:
            return
        if self.load is not None and load.controller != self.load.controller:
            if load.handover_step_V is not None:
                self.handovers_V.append(abs(load.handover_step_V))
            self.mark(load.controller)
        self.load = load
        if load.output is not None:
            disks = self.truth.disks if self.truth else self.size
            point = PlotPoint(self.clock(), load.reference, load.output, load.controller)
            self.slow.append(point)
            self.halves.add(load.reference, load.output, load.controller, disks)
            self.slow_periods += 1

    def hear_truth(self, truth: heard.Truth) -> None:
        """Record the true state of the simulator."""
        if self.truth is not None and truth.disks != self.truth.disks:
            self.mark(f"{truth.disks} disk{'s' if truth.disks > 1 else ''}")
        self.truth = truth

    def hear_event(self, event: heard.EventMessage) -> None:
        """Take an event."""
        self.events.append(event)
        if event.kind == "trip":
            self.trips.append(event.detail)

    def mark(self, text: str) -> None:
        """Note in the plot what was done."""
        self.marks.append(Mark(self.clock(), text))
