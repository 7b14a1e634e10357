"""The stage of a story: the daemon's controller and a simulated load in one process.

There is neither bus nor broker: time passes N times as fast as the clock, or as fast as the machine
counts it, and the messages of the MQTT contract go straight into a record.
"""

import asyncio
import json
import time
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

import msgspec

from adaptdrive.app.settings import operator_profile
from adaptdrive.config import file
from adaptdrive.mqtt import commands, contract
from adaptdrive.runtime import reports
from adaptdrive.runtime.accounts import state_report
from adaptdrive.safety.trips import TripKind
from adaptdrive.tui.terminal import KeyCommand
from adaptdrive.util.errors import RefusedError
from adaptdrive.util.quantity import MEASURED
from adaptdrive_sim.demo.story import DemoRecord, Story
from adaptdrive_sim.device import DeviceSettings, build_world
from adaptdrive_sim.devices.disturbances import answer, features_of
from adaptdrive_sim.parameters import EXAMPLES
from adaptdrive_sim.site import OperatedDrive

_SLICE_s = 0.02
_BREAK_s = 0.005
_REPORT_TICKS = 240
_SHOWN_s = 0.5
"""Time of the viewer between two reports, where that is less than so many half cycles."""


class Stage:
    """A drive in virtual time, and the record of its messages.

    Attributes:
        story: What is played.
        drive: The drive.
        record: Takes its messages.
        speed: Times real time.
    """

    def __init__(self, story: Story, speed: float | None = None) -> None:
        """Put the daemon's controller in front of the load of a story.

        Args:
            story: What is played.
            speed: Times real time; the story's own when left out.
        """
        path = EXAMPLES / story.configuration
        configuration = file.validate_configuration(story.document(), path)
        begin_V = story.initial_voltage_V
        device = DeviceSettings(noise_V=story.noise, initial_voltage_V=begin_V)
        self.story = story
        self.drive = OperatedDrive(configuration, build_world(configuration, device))
        self.record = DemoRecord(configuration.drive.name, time.monotonic, story=story)
        self.speed = speed or story.speed
        self._profile = operator_profile(configuration)
        self._began = datetime.now(UTC)
        self._due_s = 0.0
        self._last_s = time.monotonic()
        shown = round(_SHOWN_s * story.speed / configuration.drive.half_cycle_s)
        self._report_ticks = max(min(_REPORT_TICKS, shown), configuration.ticks_per_period // 2)
        self._last_state = ""
        self._publish("availability", {"availability": "online"})
        self.drive.tick()
        self.report()
        self._publish_state()

    @property
    def time_s(self) -> float:
        """Time of the drive."""
        return self.drive.time_s

    async def wait(self, longest_s: float) -> None:
        """Let time pass as fast as asked for, or as this machine can."""
        now_s = time.monotonic()
        since_s, self._last_s = now_s - self._last_s, now_s
        self._due_s = min(self._due_s + since_s * self.speed, self.time_s + self.speed)
        end_s = min(self.time_s + longest_s, self._due_s)
        while self.time_s < end_s and time.monotonic() < now_s + _SLICE_s:
            self._tick()
        await asyncio.sleep(_BREAK_s if self.time_s >= self._due_s else 0.0)

    async def ask(self, command: KeyCommand) -> contract.Reply | contract.DeviceReply:
        """Carry out a command or a disturbance."""
        content = {"id": "demo"} | dict(command.disturbance or {"value": command.value})
        raw, reason = json.dumps(content).encode(), ""
        if command.disturbance is not None:
            reply = answer(raw, self.drive.world)
            self._publish_state()
            return reply
        try:
            self.drive.carry_out(commands.Payload(raw).request(command.verb)[0])
        except RefusedError as refusal:
            reason = refusal.reason
        self._publish_state()
        state = self.drive.machine.state
        return contract.Reply("demo", command.verb, not reason, reason, state)

    def _tick(self) -> None:
        """Run one half line cycle."""
        drive = self.drive
        decided = drive.tick()
        if drive.ticks % self._report_ticks == 0:
            self.report()
        if decided and drive.snapshot is not None and drive.decision is not None:
            report = reports.LoadReport(drive.snapshot, drive.decision, drive.time_s)
            load = contract.load_message(report, self._now, self._profile.output)
            self._publish("telemetry/load", load)
            self._publish_truth()
            self._publish_state()
        elif drive.machine.state != self._last_state:
            self._publish_state()

    @property
    def _now(self) -> datetime:
        return self._began + timedelta(seconds=self.drive.time_s)

    def report(self) -> None:
        """Publish what the fast loop measures, and the truth."""
        sample = self.drive.sample
        content = {name: getattr(sample, name) for name in MEASURED}
        counts = {"ticks": self.drive.ticks, "missed": 0, "held": 0, "age_s": 0.0}
        self._publish("telemetry/drive", {"time": self._now, **content, **counts})
        self._publish_truth()

    def _publish_truth(self) -> None:
        world = self.drive.world
        offered = [msgspec.to_builtins(one) for one in features_of(world.load)]
        self._publish("simulator", world.truth() | {"features": offered})

    def _publish_state(self) -> None:
        """Publish the state, and its change as an event."""
        drive, machine = self.drive, self.drive.machine
        report = state_report(machine, drive.decision, reports.StopWord.CONFIRMED)
        trip = report.trip
        last = contract.LastTrip(self._now, report.trip_kind, trip, "") if trip else None
        standing = contract.Standing(self._now, last, contract.Synchronisation.UNKNOWN, self._now)
        self._publish("state", contract.state_message(report, standing, self._profile))
        if machine.state == self._last_state:
            return
        if self._last_state:
            self._event("state", f"{self._last_state} to {machine.state}")
        if trip is not None:
            self._event("trip", trip, report.trip_kind)
        if drive.completed:
            self._event("complete", "charging is complete")
        self._last_state = str(machine.state)

    def _event(self, kind: str, detail: str, trip_kind: TripKind | None = None) -> None:
        severity = reports.Severity.ALARM if kind == "trip" else reports.Severity.INFO
        event = reports.Event(kind, severity, detail, self.drive.ticks, trip_kind)
        self._publish("event", contract.event_message(event, self._now))

    def _publish(self, name: str, content: Mapping[str, Any]) -> None:
        self.record.take(name, msgspec.json.decode(contract.encode(dict(content))))
