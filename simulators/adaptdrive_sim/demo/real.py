"""The stage of a story in real time: broker, simulated drive and daemon, each a process."""

import asyncio
import os
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Coroutine
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import tomlkit

from adaptdrive.app.process import NAMESPACE
from adaptdrive.cli.desk import panel_address
from adaptdrive.config.services import Mqtt
from adaptdrive.mqtt.client import NoAnswerError
from adaptdrive.mqtt.contract import DeviceReply, Reply
from adaptdrive.processes import BROKER, Child, Ports, ProcessGroup
from adaptdrive.recording.session import Ending, read_info
from adaptdrive.tui.main import follow_drive, over_mqtt
from adaptdrive.tui.terminal import KeyCommand
from adaptdrive.util.errors import RecordingError
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.story import DemoError, DemoSettings, Story
from adaptdrive_sim.experiments.examples import FOLDER

SESSION_s = 10.0
AFTERMATH_s = 1.5
"""Time for the simulated drive to protect itself and log it when the daemon has died."""

_ANSWER_s = 10.0
_ASKED = 3
"""Times that a command without an answer is sent."""

_LOOK_s = 0.05
_WAIT_s = 0.1


_HEAD = "# Written by `adaptdrive-sim demo`. The commented original is in deploy/examples.\n\n"


class RealStage:
    """The processes of a demonstration. Use it as an async context manager.

    Attributes:
        drive_name: Name of the drive.
        directory: Its folder, with configuration, messages, logs and sessions.
        configuration: Configuration of daemon and simulated drive.
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
        self._broker = Mqtt(port=self._ports.take())
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
        found = {name: self.places[name] for name in ("bus", "broker")}
        session = None if self.session is None else str(self.session)
        return found | {"directory": self.places["folder"], "session": session}

    @property
    def broker(self) -> str:
        """The broker as HOST:PORT."""
        return f"{self._broker.host}:{self._broker.port}"

    async def wait(self, longest_s: float) -> None:
        """Let some time pass."""
        await asyncio.sleep(min(max(longest_s, 0.0), _WAIT_s))

    async def ask(self, command: KeyCommand) -> Reply | DeviceReply:
        """Send a command or a disturbance; one without an answer is sent again."""
        for _ in range(_ASKED - 1):
            with suppress(NoAnswerError):
                return await self._ask(command)
        return await self._ask(command)

    def services(self, record: DemoRecord) -> list[Coroutine[Any, Any, None]]:
        """Return what runs during the story: it hears the drive and sees processes that die."""
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
            (self.directory / database).write_bytes((FOLDER / database).read_bytes())
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
