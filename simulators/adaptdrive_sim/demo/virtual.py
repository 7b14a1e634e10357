"""The stage of a story in virtual time: one process, no bus, N times real time."""

import asyncio
import json
import time
from collections.abc import Coroutine, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any, Self

import msgspec

from adaptdrive.app.settings import operator_profile
from adaptdrive.config.bus import MEASURED
from adaptdrive.config.file import validate_configuration
from adaptdrive.mqtt import commands, contract
from adaptdrive.mqtt.contract import DeviceReply
from adaptdrive.runtime.accounts import state_report
from adaptdrive.runtime.reports import Event, LoadReport, Severity, StopWord
from adaptdrive.tui.terminal import KeyCommand
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.story import DemoError, DemoSettings, Story
from adaptdrive_sim.device import DeviceSettings, build_world
from adaptdrive_sim.devices.disturbances import answer, features_of
from adaptdrive_sim.experiments.examples import FOLDER
from adaptdrive_sim.site import OperatedDrive

_SLICE_s = 0.02
_BREAK_s = 0.005
_REPORT_TICKS = 240


class VirtualStage:
    """A drive in virtual time, whose messages go straight into a record.

    Attributes:
        drive: The drive.
        world: The plant.
        drive_name: Its name.
        record: Takes its messages.
        places: What the help shows of the surroundings.
        facts: What the summary has of them.
        session: There is no recorded session.
        has_sensors: There are no separate sensors.
    """

    has_sensors = False
    session = None

    def __init__(self, story: Story, settings: DemoSettings) -> None:
        """Put the daemon's controller in front of the load of a story."""
        configuration = validate_configuration(story.document(), FOLDER / story.configuration)
        noise = story.noise if settings.noise is None else settings.noise
        device = DeviceSettings(
            noise_V=noise, seed=settings.seed, initial_voltage_V=story.initial_voltage_V
        )
        self.drive = OperatedDrive(configuration, build_world(configuration, device))
        self.world = self.drive.world
        self.drive_name = configuration.drive.name
        self.record: DemoRecord | None = None
        self._profile = operator_profile(configuration)
        self._speed = settings.speed or story.speed or 1.0
        passing = f"virtual, {self._speed:g} times real time: no bus, no broker, no panel"
        self.places = {"time": passing}
        self.facts = {"virtual_time": True, "speed": self._speed}
        self._began = datetime.now(UTC)
        self._due_s = 0.0
        self._last_s = time.monotonic()
        self._report_ticks = max(_REPORT_TICKS, configuration.ticks_per_period // 2)
        self._told = ""

    async def __aenter__(self) -> Self:
        """Begin; there is nothing to start."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """End; there is nothing to stop."""

    def services(self, record: DemoRecord) -> list[Coroutine[Any, Any, None]]:
        """Publish the first messages into a record; nothing else runs."""
        self.record = record
        self._publish("availability", {"availability": "online"})
        self.drive.tick()
        self._report()
        self._publish_state()
        return []

    async def panel(self) -> str:
        """Refuse the panel.

        Raises:
            DemoError: There is no broker.
        """
        raise DemoError("this story passes in virtual time, without a broker")

    @property
    def time_s(self) -> float:
        """Time of the drive."""
        return self.drive.time_s

    def inject(self, fault: int) -> None:
        """Refuse a fault: there is no drive that could report one."""
        raise RefusedError(f"fault {fault}: this story has no drive process")

    async def wait(self, longest_s: float) -> None:
        """Let time pass as fast as asked for, or as this machine can."""
        now_s = time.monotonic()
        since_s, self._last_s = now_s - self._last_s, now_s
        self._due_s = min(self._due_s + since_s * self._speed, self.time_s + self._speed)
        end_s = min(self.time_s + longest_s, self._due_s)
        while self.time_s < end_s and time.monotonic() < now_s + _SLICE_s:
            self._tick()
        await asyncio.sleep(_BREAK_s if self.time_s >= self._due_s else 0.0)

    async def ask(self, command: KeyCommand) -> contract.Reply | DeviceReply:
        """Carry out a command or a disturbance."""
        content = {"id": "demo"} | dict(command.disturbance or {"value": command.value})
        raw, reason = json.dumps(content).encode(), ""
        if command.disturbance is not None:
            reply = answer(raw, self)
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
            self._report()
        if decided and drive.snapshot is not None and drive.decision is not None:
            report = LoadReport(drive.snapshot, drive.decision, drive.time_s)
            load = contract.load_message(report, self._now, self._profile.output)
            self._publish("telemetry/load", load)
            self._publish_truth()
            self._publish_state()
        elif drive.machine.state != self._told:
            self._publish_state()

    @property
    def _now(self) -> datetime:
        return self._began + timedelta(seconds=self.drive.time_s)

    def _report(self) -> None:
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
        report = state_report(machine, drive.decision, StopWord.CONFIRMED)
        last = contract.LastTrip(self._now, machine.trip, "") if machine.trip else None
        standing = contract.Standing(self._now, last, contract.Synchronisation.UNKNOWN, self._now)
        self._publish("state", contract.state_message(report, standing, self._profile))
        if machine.state == self._told:
            return
        if self._told:
            self._event("state", f"{self._told} to {machine.state}")
        if machine.trip is not None:
            self._event("trip", machine.trip, Severity.ALARM)
        if drive.completed:
            self._event("complete", "charging is complete")
        self._told = str(machine.state)

    def _event(self, kind: str, detail: str, severity: Severity = Severity.INFO) -> None:
        event = Event(kind, severity, detail, self.drive.ticks)
        self._publish("event", contract.event_message(event, self._now))

    def _publish(self, name: str, content: Mapping[str, Any]) -> None:
        if self.record is not None:
            self.record.take(name, msgspec.json.decode(contract.encode(dict(content))))
