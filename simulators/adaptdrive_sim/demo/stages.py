"""The stages of a story: processes in real time, or one process in virtual time.

In real time broker, simulated drive and daemon are processes of their own on a real bus. In virtual
time there is neither bus nor broker, and the drive lives N times faster.
"""

import asyncio
import json
import os
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Coroutine, Mapping
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Self

import msgspec
import tomlkit

from adaptdrive.app.process import NAMESPACE
from adaptdrive.app.settings import operator_profile
from adaptdrive.cli.desk import panel_address
from adaptdrive.config import file
from adaptdrive.mqtt import commands, contract
from adaptdrive.mqtt.client import NoAnswerError
from adaptdrive.mqtt.connection import Broker
from adaptdrive.processes import BROKER, Child, Ports, ProcessGroup
from adaptdrive.recording.session import Ending, read_info
from adaptdrive.runtime import reports
from adaptdrive.runtime.accounts import state_report
from adaptdrive.safety.trips import TripKind
from adaptdrive.tui import follow_drive, over_mqtt
from adaptdrive.tui.terminal import KeyCommand
from adaptdrive.util.errors import RecordingError, RefusedError
from adaptdrive.util.quantity import MEASURED
from adaptdrive_sim.demo import DemoError, DemoSettings
from adaptdrive_sim.demo.story import DemoRecord, Story
from adaptdrive_sim.device import DeviceSettings, build_world
from adaptdrive_sim.devices.disturbances import answer, features_of
from adaptdrive_sim.parameters import EXAMPLES
from adaptdrive_sim.site import OperatedDrive

# In real time: broker, simulated drive and daemon, each a process.

SESSION_s = 10.0
AFTERMATH_s = 1.5
"""Time for the simulated drive to protect itself and log it when the daemon has died."""

_ANSWER_s = 10.0
_ASKED = 3
"""Times that a command without an answer is sent."""

_LOOK_s = 0.05
_WAIT_s = 0.1

Reply = contract.Reply | contract.DeviceReply

_HEAD = "# Written by `adaptdrive-sim demo`. The commented original is in deploy/examples.\n\n"


class RealStage:
    """The processes of a demonstration. Use it as an async context manager.

    Attributes:
        drive_name: Name of the drive.
        directory: Its folder, with configuration, messages, logs and sessions.
        configuration: Configuration of daemon and simulated drive.
        broker: The broker as HOST:PORT.
        places: What the help shows of the surroundings.
    """

    def __init__(self, story: Story, settings: DemoSettings) -> None:
        """Choose folder, bus, ports and name; no other demonstration has any of them.

        Raises:
            AdaptdriveError: They cannot be had.
        """
        self._story, self._settings = story, settings
        self.directory = _made(settings.directory)
        self.configuration = self.directory / story.configuration
        self._ports = Ports()
        port, number = self._ports.take(socket.SOCK_DGRAM), os.getpid()
        group = f"239.74.{number >> 8 & 255}.{number & 255}"
        document = story.document()
        self.drive_name = str(document["drive"]["name"])
        self._broker = Broker(port=self._ports.take())
        self.broker = f"{self._broker.host}:{self._broker.port}"
        self._page, self._websocket = self._ports.take(), self._ports.take()
        document["bus"] |= {"interface": "udp_multicast", "channel": group, "udp_port": port}
        document["mqtt"] = {"host": self._broker.host, "port": self._broker.port}
        document["recording"] = {"directory": str(self.directory / "sessions")}
        self._write(document)
        state = {"STATE_DIRECTORY": str(self.directory / "state"), NAMESPACE: f"demo-{number}"}
        self._processes = ProcessGroup({**os.environ, **state})
        self._ask = over_mqtt(self._broker, self.drive_name, _ANSWER_s)
        self.places = {
            "folder": str(self.directory),
            "bus": f"udp_multicast {group}:{port}",
            "broker": self.broker,
            "try": f"{program()} mode {self.drive_name} adaptive --broker {self.broker}",
        }

    async def __aenter__(self) -> Self:
        """Start the processes."""
        try:
            await self._start()
        except BaseException:
            await self._processes.stop()
            raise
        return self

    async def __aexit__(self, _kind: object, problem: object, _trace: object) -> None:
        """End the processes, and wait until the session is closed."""
        if problem is not None:
            await asyncio.sleep(AFTERMATH_s)
        await self._processes.stop()
        self.close()
        with suppress(TimeoutError, RecordingError):
            async with asyncio.timeout(SESSION_s):
                while (session := self.session) is not None:
                    if read_info(session).ended is not Ending.OPEN:
                        return
                    await asyncio.sleep(_LOOK_s)

    def close(self) -> None:
        """Give the ports back."""
        self._ports.close()

    @property
    def time_s(self) -> float:
        """Monotonic time."""
        return time.monotonic()

    @property
    def session(self) -> Path | None:
        """The recorded session; None when there is none."""
        found = (path.parent for path in self.directory.glob("sessions/2*/session.json"))
        return max(found, default=None)

    @property
    def facts(self) -> dict[str, Any]:
        """Surroundings of the demonstration, for its summary."""
        session = None if self.session is None else str(self.session)
        own = {"directory": self.places["folder"], "session": session}
        return {name: self.places[name] for name in ("bus", "broker")} | own

    async def wait(self, longest_s: float) -> None:
        """Let some time pass."""
        await asyncio.sleep(min(max(longest_s, 0.0), _WAIT_s))

    async def ask(self, command: KeyCommand) -> Reply:
        """Send a command or a disturbance; one without an answer is sent again."""
        for _ in range(_ASKED - 1):
            with suppress(NoAnswerError):
                return await self._ask(command)
        return await self._ask(command)

    def services(self, record: DemoRecord) -> list[Coroutine[Any, Any, None]]:
        """Return what runs during the story: the drive's messages, and a watch of processes."""
        return [self._processes.watch(), follow_drive(self._broker, record)]

    async def panel(self) -> str:
        """Serve the panel, and return its address."""
        websocket = f"ws://127.0.0.1:{self._websocket}/mqtt"
        page = ["panel", "--no-open", f"--port={self._page}", f"--broker={websocket}"]
        if not self._processes.has("panel"):
            panel = await self._start_process("panel", "adaptdrive.cli", page, "panel")
            await panel.until_listening(self._page)
        return panel_address(self._page, websocket)

    async def _start(self) -> None:
        listeners = [self.broker, f"127.0.0.1:{self._websocket}"]
        broker = await self._start_process("broker", BROKER, listeners, "broker")
        await broker.until_listening(self._broker.port)
        configuration = str(self.configuration)
        noise = self._story.noise if self._settings.noise is None else self._settings.noise
        device = [
            *("device", configuration, f"--broker={self.broker}"),
            *(f"--noise={noise!r}", f"--seed={self._settings.seed}"),
            f"--initial-voltage={self._story.initial_voltage_V}",
        ]
        await self._start_process("simulated drive", "adaptdrive_sim", device, "drive")
        await self._start_process("daemon", "adaptdrive.cli", ["run", configuration], "daemon")

    async def _start_process(self, name: str, module: str, words: list[str], log: str) -> Child:
        return await self._processes.start(name, module, words, self.directory / f"{log}.log")

    def _write(self, document: dict[str, Any]) -> None:
        """Write the configuration and the messages that it names.

        Raises:
            DemoError: The folder cannot be written.
        """
        database = document["bus"]["database"]
        try:
            (self.directory / database).write_bytes((EXAMPLES / database).read_bytes())
            self.configuration.write_text(_HEAD + tomlkit.dumps(document), encoding="utf-8")
        except OSError as problem:
            raise DemoError(f"{self.directory}: {problem.strerror or problem}") from problem


def _made(directory: Path | None) -> Path:
    """Make the folder of a demonstration; one that no other demonstration has, when None.

    Raises:
        DemoError: It cannot be made.
    """
    try:
        if directory is None:
            parent = Path("build", "demo").absolute()
            parent.mkdir(parents=True, exist_ok=True)
            now = datetime.now(UTC)
            directory = Path(tempfile.mkdtemp(prefix=f"{now:%Y%m%dT%H%M%SZ}-", dir=parent))
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise DemoError(f"{problem.filename}: {problem.strerror}") from problem
    return directory.absolute()


def program(name: str = "adaptdrive") -> str:
    """Return the command for a program: its name, or its path if the name is not found."""
    if shutil.which(name):
        return name
    path = Path(sys.executable).with_name(name)
    return os.path.relpath(path) if path.is_relative_to(Path.cwd()) else str(path)


# In virtual time: one process, no bus, N times real time.

_SLICE_s = 0.02
_BREAK_s = 0.005
_REPORT_TICKS = 240


class VirtualStage:
    """A drive in virtual time, whose messages go straight into a record.

    Attributes:
        drive: The drive.
        drive_name: Its name.
        record: Takes its messages.
        places: What the help shows of the surroundings.
        facts: What the summary has of them.
        session: There is no recorded session.
    """

    session = None

    def __init__(self, story: Story, settings: DemoSettings) -> None:
        """Put the daemon's controller in front of the load of a story."""
        path = EXAMPLES / story.configuration
        configuration = file.validate_configuration(story.document(), path)
        noise = story.noise if settings.noise is None else settings.noise
        begin_V = story.initial_voltage_V
        device = DeviceSettings(noise_V=noise, seed=settings.seed, initial_voltage_V=begin_V)
        self.drive = OperatedDrive(configuration, build_world(configuration, device))
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
        self._last_state = ""

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

    async def wait(self, longest_s: float) -> None:
        """Let time pass as fast as asked for, or as this machine can."""
        now_s = time.monotonic()
        since_s, self._last_s = now_s - self._last_s, now_s
        self._due_s = min(self._due_s + since_s * self._speed, self.time_s + self._speed)
        end_s = min(self.time_s + longest_s, self._due_s)
        while self.time_s < end_s and time.monotonic() < now_s + _SLICE_s:
            self._tick()
        await asyncio.sleep(_BREAK_s if self.time_s >= self._due_s else 0.0)

    async def ask(self, command: KeyCommand) -> Reply:
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
            self._report()
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
        if self.record is not None:
            self.record.take(name, msgspec.json.decode(contract.encode(dict(content))))
