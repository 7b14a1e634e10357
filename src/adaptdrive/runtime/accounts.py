"""Reports of a daemon, collected from its parts: to the hub on each change, and in one line."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields

from adaptdrive.control.signals import Decision, Mode
from adaptdrive.devices.port import PortStatistics
from adaptdrive.devices.sensors import SensorBus
from adaptdrive.runtime import fast_loop, program, reports, requests, state_machine, tick_support
from adaptdrive.safety.trips import Trip, TripKind

_WARNING_S = 1.0
"""Shortest time between two events of warnings: a bit may change in every half cycle."""

_NAMES = tuple(field.name for field in fields(PortStatistics))


def state_report(
    machine: state_machine.Machine,
    decision: Decision | None,
    stop: reports.StopWord,
    *,
    shutting_down: bool = False,
    program: requests.ProgramReport | None = None,
) -> reports.StateReport:
    """Return state and mode of a drive, for operators.

    Args:
        machine: The state machine.
        decision: The decision in force, None while there is none.
        stop: Confirmation of the stop by the drive.
        shutting_down: Whether the daemon ends.
        program: The program that runs, or has run last.
    """
    trip, asked = machine.trip, machine.asked
    return reports.StateReport(
        state=machine.state,
        mode=machine.mode,
        controller=_source(machine.mode, decision),
        reason=machine.obstacle or _reason(machine, decision),
        enabled=machine.energised,
        setpoint=asked.setpoint,
        slope=None if asked.ramp is None else asked.ramp.slope,
        waveform=asked.waveform,
        pole=machine.pole,
        trip=None if trip is None else trip.text,
        trip_kind=None if trip is None else trip.kind,
        shutting_down=shutting_down,
        stop=stop if machine.commanded_off else None,
        voltage_V=machine.manual.target_V if machine.mode is Mode.MANUAL else None,
        reach=machine.reach,
        coasting=machine.coasting,
        program=program,
    )


def _reason(machine: state_machine.Machine, decision: Decision | None) -> str:
    """Return why adaptive is not in force, or may not fit the load any more, and any probe."""
    adaptive = machine.mode is Mode.ADAPTIVE
    if decision is None:  # a run has none before its first slow period
        running = machine.state is reports.State.RUNNING
        undecided = "waiting for the first slow period of this run" if running else "not running"
        return undecided if adaptive else ""
    waiting = adaptive and _source(machine.mode, decision) is Mode.FIXED
    informed = not math.isnan(decision.probe) or (adaptive and decision.accepted)
    return decision.reason if waiting or (machine.energised and informed) else ""


def _source(mode: Mode, decision: Decision | None) -> Mode:
    """Return the source of V_c in force: from and to manual it changes at once."""
    if mode is Mode.MANUAL:
        return mode
    decided = decision.controller if decision is not None else Mode.FIXED
    return Mode.FIXED if decided is Mode.MANUAL else decided


def status_line(report: reports.StateReport, bus_problem: str | None, cause: Trip | None) -> str:
    """Return the state of a drive and what it waits for.

    Args:
        report: The state.
        bus_problem: Why the bus is lost, None while it is there.
        cause: Interlock that is active now, None for none. Only its kind is returned: the figures
            of its text change all the time.
    """
    obstacle = bus_problem or (cause and cause.kind)
    match report.state:
        case reports.State.STANDBY:
            awaited = f"the drive ({obstacle})" if obstacle else "enable"
            return f"standby, waiting for {awaited}"
        case reports.State.STARTING:
            return "starting, waiting for the boost voltage"
        case reports.State.TRIPPED:
            awaited = f"its cause to go ({obstacle})" if obstacle else "reset"
            return f"tripped, waiting for {awaited}: {report.trip}"
        case reports.State.STOPPING:
            return "stopping, waiting for the drive to confirm that its bridge is off"
        case reports.State.RUNNING if report.coasting:
            return f"running, {report.reason}"
        case reports.State.RUNNING:
            why = f": {report.reason}" if report.reason else ""
            return f"running, {report.controller} controller{why}"


def drive_report(
    fast: fast_loop.FastLoop,
    bus: PortStatistics,
    sensors: tuple[reports.SensorReport, ...],
    now_s: float,
    remaining_s: float | None = None,
) -> reports.DriveReport:
    """Measurement, command and the counts of the fast loop; its windows of time begin anew.

    Args:
        fast: The fast loop.
        bus: Counts of the port; what the loop withheld from it is added to its own.
        sensors: State of the sensor buses.
        now_s: Monotonic time.
        remaining_s: Least time to the end of the program that runs.
    """
    return reports.DriveReport(
        measurement=fast.measurement,
        age_s=now_s - fast.reading.oldest_s if fast.reading else math.nan,
        command=fast.command,
        ticks=fast.ticks,
        missed=fast.missed,
        held=fast.held,
        limited=fast.guard.limited,
        lateness_us=fast.lateness.take(),
        turnaround_us=fast.turnaround.take(),
        bus={**_counts(bus), "withheld_commands": bus.withheld_commands + fast.withheld},
        tick_us=fast.tick_time.take(),
        sensors=sensors,
        histograms={
            "lateness_us": fast.lateness.histogram,
            "turnaround_us": fast.turnaround.histogram,
            "tick_us": fast.tick_time.histogram,
        },
        time_s=now_s,
        remaining_s=remaining_s,
    )


def _counts(bus: PortStatistics) -> dict[str, int]:
    """Return the counts of a bus by name, in a tenth of the time of `asdict`."""
    return {name: getattr(bus, name) for name in _NAMES}


def sensor_report(bus: SensorBus, now_s: float) -> reports.SensorReport:
    """Return the state of a sensor bus, its latest values and their ages.

    Args:
        bus: The sensor bus.
        now_s: Monotonic time.
    """
    return reports.SensorReport(
        name=bus.name,
        up=bus.up,
        detail=bus.detail,
        values=dict(bus.values),
        age_s={name: now_s - taken_s for name, taken_s in bus.taken_s.items()},
        bus=_counts(bus.port.statistics),
    )


def sensor_sample(buses: Sequence[SensorBus], now_s: float) -> reports.SensorSample:
    """Return the latest values of sensor buses and their ages.

    Args:
        buses: The sensor buses.
        now_s: Monotonic time.
    """
    found = [(f"{bus.name}.{name}", bus, name) for bus in buses for name in bus.values]
    values = {column: bus.values[name] for column, bus, name in found}
    age_s = {column: now_s - bus.taken_s[name] for column, bus, name in found}
    return reports.SensorSample(now_s, values, age_s)


# The share of its frames that a port has to refuse, over a window of time.
#
# A lost or disturbed frame now and then is what the age of the values is for. A large share of them
# for long is a mistake in the configuration, a second sender or a bad cable. It can go unnoticed:
# where every other frame is refused, no value ever grows old.

WINDOW_S = 5.0
"""Longer than a burst of noise, shorter than the time to damage a load."""

_LEAST_FRAMES = 20
"""Frames in a window from which on a share is judged: one of them is half of the share noted."""

_NOTED_SHARE = 0.1
"""Share that is reported; a bus in order refuses less than one frame in a thousand."""

_FORGOTTEN_SHARE = 0.05
"""Share below which the next one is reported again."""

_CAUSES = {
    "wrong_checksum": "is crc, data_id or data_id_mode of [bus.integrity] another one, "
    "does a second sender use the id, or is the cable disturbed?",
    "wrong_length": "does the DBC, the EDS or the register map describe another version?",
    "counter_stuck": "does the sender hang, or does a gateway repeat its frames?",
    "out_of_range": "is a scale, an offset or a range wrong, or a sensor broken?",
    "exceptions": "does the device have these registers, and does it take commands (remote mode)?",
    "timeouts": "are the baud rate, the device id and the cable right, and the time-out long "
    "enough?",
}


class RefusedShare:
    """Measures the share of one port."""

    def __init__(self, name: str, limit: float) -> None:
        """Start without a count.

        Args:
            name: Name of the port in reports.
            limit: Share that must not be reached while the drive is energised, 0 for any.
        """
        self._name = name
        self._limit = limit
        self._marks: deque[tuple[float, Mapping[str, int]]] = deque()
        self._noted = False
        self.cause: Trip | None = None

    def add(self, now_s: float, counts: Mapping[str, int]) -> str | None:
        """Take the counts of the port, and judge its share anew.

        Args:
            now_s: Monotonic time.
            counts: Its statistics by name.

        Returns:
            What is to be reported, None for nothing new.
        """
        marks = self._marks
        marks.append((now_s, counts))
        while len(marks) > 1 and now_s - marks[1][0] >= WINDOW_S:
            marks.popleft()
        since_s, first = marks[0]
        grown = {name: counts[name] - first[name] for name in counts}
        judged = _judged(grown)
        if now_s - since_s < WINDOW_S or judged < _LEAST_FRAMES:
            self.cause = None
            return None
        refused = _refused(grown)
        share = min(1.0, sum(refused.values()) / judged)
        text = self._text(share, judged, refused)
        trips = self._limit and share >= self._limit
        full = f"refused frames: {text}, limit {self._limit:.0%}"
        self.cause = Trip(TripKind.REFUSED_SHARE, full) if trips else None
        noted, least = self._noted, _FORGOTTEN_SHARE if self._noted else _NOTED_SHARE
        self._noted = share >= least
        return text if self._noted and not noted else None

    def _text(self, share: float, judged: int, refused: Mapping[str, int]) -> str:
        reason = max(refused, key=lambda name: refused[name])
        return (
            f"{self._name}: {share:.0%} of the last {judged} frames were refused, most for "
            f"{reason} ({refused[reason]}): {_CAUSES[reason]} `adaptdrive probe` shows them"
        )


def _judged(grown: Mapping[str, int]) -> int:
    """Return the frames that were meant for this port; for one that polls, its requests.

    A port that receives nothing refuses nothing: its values age.
    """
    asked = grown["exceptions"] + grown["timeouts"]
    if not asked:
        return grown["received"] - grown["foreign"]
    answered = grown["received"] + grown["exceptions"]
    return answered + grown["timeouts"] if answered else 0


def _refused(grown: Mapping[str, int]) -> dict[str, int]:
    """Return the frames that were refused, by reason."""
    refused = {name: grown[name] for name in _CAUSES}
    # a disturbed reply on a serial line is a missing one, too
    disturbed = refused["wrong_checksum"] + refused["wrong_length"]
    refused["timeouts"] = max(0, refused["timeouts"] - disturbed)
    return refused


# Announcements of changes.


class Announcer:
    """Publishes the state of a drive, and an event for each change of it.

    Attributes:
        decision: The decision in force, None while there is none.
        shutting_down: Whether the daemon is about to end.
        published: The last report of the state.
    """

    def __init__(
        self,
        programs: program.Programs,
        fast: fast_loop.FastLoop,
        hub: reports.Hub,
        manager: tick_support.ServiceManager,
        recorded: Callable[[], bool],
    ) -> None:
        """Publish nothing yet.

        Args:
            programs: The state machine and its program.
            fast: The fast loop.
            hub: Receiver of reports.
            manager: The service manager.
            recorded: Returns whether all that is to be recorded is.
        """
        self._machine, self._programs, self._fast = programs.machine, programs, fast
        self._hub = hub
        self._manager = manager
        self._recorded = recorded
        self._bus_problem: str | None = None
        self._warning, self._warned_s = "", -math.inf
        self.decision: Decision | None = None
        self.shutting_down = False
        self.published = state_report(self._machine, None, fast.stopping.status)

    @property
    def outdated(self) -> bool:
        """True if the state, or the confirmation of a stop, is another than the published one."""
        stop = self._fast.stopping.status if self._machine.commanded_off else None
        return self._machine.state is not self.published.state or stop is not self.published.stop

    def publish_state(self) -> None:
        """Publish the state if it has changed, and the event of its change."""
        last = self.published
        ends, stop = self.shutting_down, self._fast.stopping.status
        report = state_report(
            self._machine, self.decision, stop, shutting_down=ends, program=self._programs.report
        )
        if report == last:
            return
        self.published = report
        self._hub.publish(report)
        if report.state is not last.state:
            self._report_state(report, last)
        elif report.controller is not last.controller:
            self._report_controller(report, last)
        if report.program is not None and report.program != last.program:
            self.publish_event("program", reports.Severity.INFO, report.program.text)

    def report_bus(self, *, up: bool, detail: str) -> None:
        """Publish the loss or the return of the bus."""
        self.publish_event("bus", reports.Severity.INFO if up else reports.Severity.WARNING, detail)
        self._bus_problem = None if up else detail
        self.update_manager()

    def update_manager(self) -> None:
        """Give the service manager the status in one line, and whether recording has failed."""
        line = status_line(self.published, self._bus_problem, self._fast.cause)
        self._manager.status(line if self._recorded() else f"{line}; recording has failed")

    def report_warning(self, warning: str, arrival_s: float) -> None:
        """Publish that the warnings of the drive are others than before.

        Args:
            warning: Their names, empty for none.
            arrival_s: Arrival of the reading that has them.
        """
        if warning == self._warning or arrival_s - self._warned_s < _WARNING_S:
            return
        severity = reports.Severity.WARNING if warning else reports.Severity.INFO
        detail = warning or f"none any more; the last was {self._warning}"
        self._warning, self._warned_s = warning, arrival_s
        self.publish_event("warning", severity, f"drive warning: {detail}")

    def publish_event(self, kind: str, severity: reports.Severity, detail: str) -> None:
        """Publish an event of the present tick."""
        self._hub.publish(reports.Event(kind, severity, detail, self._fast.tick))

    def publish_alarm(self, kind: str, trip: Trip) -> None:
        """Publish the alarm for a trip, or for what would be one."""
        alarm, tick = reports.Severity.ALARM, self._fast.tick
        self._hub.publish(reports.Event(kind, alarm, trip.text, tick, trip.kind))

    def _report_state(self, report: reports.StateReport, last: reports.StateReport) -> None:
        if self._machine.trip is not None and last.trip is None:
            self.publish_alarm("trip", self._machine.trip)
        self.publish_event("state", reports.Severity.INFO, f"{last.state} to {report.state}")
        self.update_manager()

    def _report_controller(self, report: reports.StateReport, last: reports.StateReport) -> None:
        fell_back = (last.controller, report.controller) == (Mode.ADAPTIVE, Mode.FIXED)
        if fell_back and report.mode is Mode.ADAPTIVE:
            self.publish_event("fallback", reports.Severity.WARNING, report.reason)
        else:
            detail = f"{report.controller} controller in force"
            self.publish_event("controller", reports.Severity.INFO, detail)
