"""A drive in virtual time, and the record that the live view shows of it.

The messages that the daemon would publish go straight into the record; the drive is its clock.
"""

from __future__ import annotations

from dataclasses import fields
from datetime import UTC, datetime, timedelta

from adaptdrive.config.root import Configuration
from adaptdrive.control.signals import Decision, Snapshot
from adaptdrive.runtime.accounts import state_report
from adaptdrive.runtime.reports import Severity, StopWord
from adaptdrive.runtime.requests import Request
from adaptdrive_sim.demo import heard
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.virtual import OperatedDrive
from adaptdrive_sim.world import World

_NO_LATENESS = heard.QuantilesMessage(None, None, None)
_REPORT_TICKS = 240


class Play:
    """One drive and its record.

    Attributes:
        drive: The drive.
        record: What was heard.
    """

    def __init__(self, configuration: Configuration, world: World) -> None:
        self.drive = OperatedDrive(configuration, world)
        self.record = DemoRecord(datetime.now(UTC), lambda: self.drive.time_s, connected=True)
        self._report_ticks = max(_REPORT_TICKS, configuration.ticks_per_period // 2)
        self._told = ""
        self._publish_state()

    def ask(self, request: Request) -> None:
        """Carry out an operator's request.

        Raises:
            RefusedError: The drive refuses it.
        """
        self.drive.carry_out(request)
        self._publish_state()

    def event(self, kind: str, detail: str, severity: Severity = Severity.INFO) -> None:
        """Add an event."""
        self.record.hear_event(
            heard.EventMessage(kind, severity, detail, self.drive.ticks, time=self._now())
        )

    def tick(self) -> bool:
        """Run one half line cycle; return whether a slow period has ended with it."""
        drive = self.drive
        decided = drive.tick()
        if drive.ticks % self._report_ticks == 0:
            self.report()
        if decided and drive.snapshot is not None and drive.decision is not None:
            self._publish_decision(drive.snapshot, drive.decision)
        if drive.machine.state != self._told:
            self._publish_state()
        return decided

    def report(self) -> None:
        """Publish what the fast loop does."""
        drive = self.drive
        values = drive.sample.boost_voltage_V, drive.sample.load_power_W, drive.sample.output
        self.record.hear_drive(heard.DriveMessage(*values, drive.ticks, 0, 0, _NO_LATENESS))

    def _now(self) -> datetime:
        return self.record.began + timedelta(seconds=self.drive.time_s)

    def _publish_decision(self, snapshot: Snapshot, decision: Decision) -> None:
        estimates = {
            name: heard.EstimateMessage(estimate.value, estimate.std)
            for name, estimate in decision.estimates.items()
        }
        self.record.hear_load(
            heard.LoadMessage(
                time=self._now(),
                k=decision.k,
                reference=snapshot.order.reference,
                output=snapshot.output,
                boost_reference_V=decision.boost_reference_V,
                estimates=estimates,
                controller=str(decision.controller),
                handover_step_V=decision.handover_step_V,
            )
        )
        self._publish_state()

    def _publish_state(self) -> None:
        """Publish the state, and its change as an event."""
        drive, machine = self.drive, self.drive.machine
        report = state_report(machine, drive.decision, StopWord.AWAITED)
        values = {one.name: getattr(report, one.name) for one in fields(report)}
        self.record.hear_state(heard.StateMessage(**values, time=self._now()))
        if machine.state != self._told:
            if self._told:
                self.event("state", f"{self._told} to {machine.state}")
            if machine.trip is not None:
                self.event("trip", machine.trip, Severity.ALARM)
            if drive.completed:
                self.event("complete", "charging is complete")
            self._told = str(machine.state)
