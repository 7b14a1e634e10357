"""Reports of the daemon's state: to the hub on each change, and to the service manager."""

from __future__ import annotations

from collections.abc import Callable

from adaptdrive.control.signals import Decision, Mode
from adaptdrive.runtime.accounts import state_report, status_line
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.machine import Machine
from adaptdrive.runtime.reports import Event, Severity, StateReport
from adaptdrive.runtime.watchdog import ServiceManager


class Announcer:
    """Publishes the state of a drive, and an event for each change of it.

    Attributes:
        decision: The decision in force, None while there is none.
        shutting_down: Whether the daemon is about to end.
        published: The last report of the state.
    """

    def __init__(
        self,
        machine: Machine,
        fast: FastLoop,
        hub: Hub,
        manager: ServiceManager,
        recorded: Callable[[], bool],
    ) -> None:
        """Publish nothing yet.

        Args:
            machine: The state machine.
            fast: The fast loop.
            hub: Receiver of reports.
            manager: The service manager.
            recorded: Returns whether all that is to be recorded is.
        """
        self._machine = machine
        self._fast = fast
        self._hub = hub
        self._manager = manager
        self._recorded = recorded
        self._bus_problem: str | None = None
        self.decision: Decision | None = None
        self.shutting_down = False
        self.published = state_report(machine, None, fast.stop)

    @property
    def outdated(self) -> bool:
        """True if the state, or the confirmation of a stop, is another than the published one."""
        stop = self._fast.stop if self._machine.commanded_off else None
        return self._machine.state is not self.published.state or stop is not self.published.stop

    def publish_state(self) -> None:
        """Publish the state if it has changed, and the event of its change."""
        last = self.published
        ends, stop = self.shutting_down, self._fast.stop
        report = state_report(self._machine, self.decision, stop, shutting_down=ends)
        if report == last:
            return
        self.published = report
        self._hub.publish(report)
        if report.state is not last.state:
            self._report_state(report, last)
        elif report.controller is not last.controller:
            self._report_controller(report, last)

    def report_bus(self, *, up: bool, detail: str) -> None:
        """Publish the loss or the return of the bus."""
        self.publish_event("bus", Severity.INFO if up else Severity.WARNING, detail)
        self._bus_problem = None if up else detail
        self.update_manager()

    def update_manager(self) -> None:
        """Give the service manager the status in one line."""
        line = status_line(
            self.published, self._bus_problem, self._fast.cause, recorded=self._recorded()
        )
        self._manager.status(line)

    def publish_event(self, kind: str, severity: Severity, detail: str) -> None:
        """Publish an event of the present tick."""
        self._hub.publish(Event(kind, severity, detail, self._fast.tick))

    def _report_state(self, report: StateReport, last: StateReport) -> None:
        if report.trip is not None and last.trip is None:
            self.publish_event("trip", Severity.ALARM, report.trip)
        self.publish_event("state", Severity.INFO, f"{last.state} to {report.state}")
        self.update_manager()

    def _report_controller(self, report: StateReport, last: StateReport) -> None:
        fell_back = (last.controller, report.controller) == (Mode.ADAPTIVE, Mode.FIXED)
        if fell_back and report.mode is Mode.ADAPTIVE:
            self.publish_event("fallback", Severity.WARNING, report.reason)
        else:
            detail = f"{report.controller} controller in force"
            self.publish_event("controller", Severity.INFO, detail)
