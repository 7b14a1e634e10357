"""The stage of a story in real time: broker, simulated drive and daemon, each a process."""

from __future__ import annotations

import asyncio
import os
import socket
import time
from collections.abc import Coroutine
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from adaptdrive.app.lock import NAMESPACE
from adaptdrive.cli.panel import panel_address
from adaptdrive.config.services import Mqtt
from adaptdrive.errors import RecordingError
from adaptdrive.household.ports import Ports
from adaptdrive.household.processes import BROKER, Household
from adaptdrive.operation.conversation import NoAnswerError, conversation, end_of
from adaptdrive.operation.messages import Reply
from adaptdrive.operation.simulator import DeviceReply
from adaptdrive.recording.session import Ending, read_info
from adaptdrive.watch.keys import KeyCommand
from adaptdrive.watch.main import follow_drive
from adaptdrive.watch.sending import over_mqtt
from adaptdrive_sim.broker import parse_address
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.settings import DemoError, DemoSettings
from adaptdrive_sim.demo.story import Story
from adaptdrive_sim.demo.workspace import make_workspace, program

CONNECT_s = 3.0
"""Longest wait for the connection to a running broker."""

SESSION_s = 10.0
AFTERMATH_s = 1.5
"""Time for the simulated drive to protect itself and log it when the daemon has died."""

_ANSWER_s = 10.0
_ASKED = 3
"""Times that a command without an answer is sent."""

_LOOK_s = 0.05
_WAIT_s = 0.1


class RealStage:
    """The processes of a demonstration. Use it as an async context manager.

    Attributes:
        drive_name: Name of the drive.
        workspace: Its folder.
        places: What the help shows of the surroundings.
    """

    def __init__(self, story: Story, settings: DemoSettings) -> None:
        """Choose folder, bus, ports and name; no other demonstration has any of them.

        Raises:
            AdaptdriveError: They cannot be had.
        """
        self._story, self._settings = story, settings
        self.workspace = make_workspace(settings.directory, story.configuration)
        self._ports = Ports()
        port, number = self._ports.take(socket.SOCK_DGRAM), os.getpid()
        group = f"239.74.{number >> 8 & 255}.{number & 255}"
        document = story.document()
        self.drive_name = str(document["drive"]["name"])
        if settings.broker is None:
            self._broker = Mqtt(port=self._ports.take())
            self._page, self._websocket = self._ports.take(), self._ports.take()
        else:
            self._broker = parse_address(settings.broker)
            self.drive_name = f"{self.drive_name}-{number}"  # others share that broker
        document["drive"]["name"] = self.drive_name
        document["bus"] |= {"interface": "udp_multicast", "channel": group, "udp_port": port}
        document["mqtt"] = {"host": self._broker.host, "port": self._broker.port}
        document["recording"] = {"directory": str(self.workspace.sessions)}
        self.workspace.write(document)
        state = {"STATE_DIRECTORY": str(self.workspace.state), NAMESPACE: f"demo-{number}"}
        self._household = Household({**os.environ, **state})
        self._ask = over_mqtt(self._broker, self.drive_name, _ANSWER_s)
        self.places = {
            "folder": str(self.workspace.directory),
            "bus": f"udp_multicast {group}:{port}",
            "broker": self.broker,
            "try": f"{program()} mode {self.drive_name} adaptive --broker {self.broker}",
        }

    async def __aenter__(self) -> Self:
        """Start the processes."""
        try:
            await self._start()
        except BaseException:
            await self._household.stop()
            raise
        return self

    async def __aexit__(self, _kind: object, problem: object, _trace: object) -> None:
        """End the processes, and wait until the session is closed."""
        if problem is not None:
            await asyncio.sleep(AFTERMATH_s)
        await self._household.stop()
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
        """The recorded session."""
        return self.workspace.session()

    @property
    def facts(self) -> dict[str, Any]:
        """Surroundings of the demonstration, for its summary."""
        found = {name: self.places[name] for name in ("bus", "broker")}
        session = None if self.session is None else str(self.session)
        return found | {"directory": self.places["folder"], "session": session}

    @property
    def broker(self) -> str:
        """The broker as HOST:PORT."""
        host, port = self._broker.host, self._broker.port
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

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
        return [self._household.watch(), follow_drive(self._broker, record)]

    async def panel(self) -> str:
        """Serve the panel, and return its address.

        Raises:
            DemoError: The broker has no websocket for it.
        """
        if self._settings.broker is not None:
            raise DemoError("the panel needs the broker of the demonstration")
        websocket = f"ws://127.0.0.1:{self._websocket}/mqtt"
        page = ["panel", "--no-open", f"--port={self._page}", f"--broker={websocket}"]
        if not self._household.has("panel"):
            log = self.workspace.log("panel")
            panel = await self._household.start("panel", "adaptdrive.cli", page, log)
            await panel.until_listening(self._page)
        return panel_address(self._page, websocket)

    async def _start(self) -> None:
        household, log = self._household, self.workspace.log
        if self._settings.broker is None:
            listeners = [self.broker, f"127.0.0.1:{self._websocket}"]
            broker = await household.start("broker", BROKER, listeners, log("broker"))
            await broker.until_listening(self._broker.port)
        else:
            await self._find_broker()
        configuration = str(self.workspace.configuration)
        noise = self._story.noise if self._settings.noise is None else self._settings.noise
        device = [
            *("device", configuration, f"--broker={self.broker}"),
            *(f"--noise={noise!r}", f"--seed={self._settings.seed}"),
            f"--initial-voltage={self._story.initial_voltage_V}",
        ]
        await household.start("simulated drive", "adaptdrive_sim", device, log("drive"))
        daemon = ["run", configuration]
        await household.start("daemon", "adaptdrive.cli", daemon, log("daemon"))

    async def _find_broker(self) -> None:
        try:
            async with conversation(self._broker, self.drive_name, end_of(CONNECT_s)):
                return
        except NoAnswerError as silence:
            raise DemoError(silence.problem) from silence
