"""One demonstration from its first process to its summary."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from adaptdrive.app.lock import NAMESPACE
from adaptdrive.cli.panel import panel_address
from adaptdrive.config.services import Mqtt
from adaptdrive.errors import AdaptdriveError, RecordingError, first_error
from adaptdrive.operation.conversation import NoAnswerError, conversation, end_of
from adaptdrive.operation.listener import read_status
from adaptdrive.operation.messages import ONLINE
from adaptdrive.recording.session import Ending, read_info
from adaptdrive_sim.broker import BrokerAddress, parse_address
from adaptdrive_sim.demo.bus import BusChoice, choose_bus, free_port
from adaptdrive_sim.demo.director import Director
from adaptdrive_sim.demo.listener import DemoListener
from adaptdrive_sim.demo.processes import Household
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.settings import DRIVE, REST_BOOST_V, DemoError, DemoSettings
from adaptdrive_sim.demo.summary import Places, summarise
from adaptdrive_sim.demo.workspace import Workspace, make_workspace

BROKER_s = 20.0
CONNECT_s = 3.0
"""Longest wait for the connection to a running broker."""

RETAINED_s = 1.0
SESSION_s = 5.0
AFTERMATH_s = 0.3
"""Time for the simulated drive to protect itself and log it when the daemon has died."""

_LOOK_s = 0.05


@dataclass(frozen=True, slots=True)
class PanelPlace:
    """Ports of the panel on the loopback interface, beside the embedded broker.

    Attributes:
        page: Port of the page.
        websocket: Port of the broker's WebSocket listener.
    """

    page: int
    websocket: int

    @property
    def broker(self) -> str:
        """Address of the WebSocket listener."""
        return f"ws://127.0.0.1:{self.websocket}/mqtt"

    @property
    def address(self) -> str:
        """Address of the page."""
        return panel_address(self.page, self.broker)


@dataclass(frozen=True, slots=True)
class Venue:
    """Place of a demonstration."""

    bus: BusChoice
    broker: BrokerAddress
    workspace: Workspace
    panel: PanelPlace | None = None

    @property
    def broker_text(self) -> str:
        """The broker as HOST:PORT."""
        host, port = self.broker.host, self.broker.port
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    @property
    def mqtt(self) -> Mqtt:
        """The broker, in the words of the configuration."""
        return self.broker.mqtt


Show = Callable[[DemoRecord, Venue], Awaitable[None]]
"""Shows a record until cancelled."""


@dataclass(frozen=True, slots=True)
class DemoOutcome:
    """Result of a demonstration.

    Attributes:
        summary: The figures.
        failure: What ended it early, None when nothing did.
    """

    summary: dict[str, Any]
    failure: AdaptdriveError | None


async def perform(settings: DemoSettings, show: Show) -> DemoOutcome:
    """Run a demonstration until its time is over, it fails, or a signal asks for its end.

    Args:
        settings: What is wanted.
        show: Shows it.

    Raises:
        AdaptdriveError: It cannot even begin.
    """
    asked = end_on_signals()
    scene = await _set_up(settings)
    record = DemoRecord(datetime.now(UTC), time.monotonic)
    failure: AdaptdriveError | None = None
    environment = {
        **os.environ,
        "STATE_DIRECTORY": str(scene.workspace.state),
        NAMESPACE: f"demo-{os.getpid()}",
    }
    async with Household(environment) as household:
        try:
            await _start(household, settings, scene)
            await _play(household, settings, scene, record, show, asked)
        except* AdaptdriveError as problems:
            failure = first_error(problems)
            await asyncio.sleep(AFTERMATH_s)
    await _session_closed(scene.workspace)
    places = Places(
        bus=str(scene.bus),
        broker=scene.broker_text,
        directory=scene.workspace.directory,
        session=scene.workspace.session(),
    )
    return DemoOutcome(summarise(record, places, str(failure) if failure else None), failure)


def end_on_signals() -> asyncio.Event:
    """Return an event that SIGINT, SIGTERM and SIGHUP set."""
    asked = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, asked.set)
    return asked


async def _set_up(settings: DemoSettings) -> Venue:
    bus = choose_bus(settings.interface, settings.channel)
    if settings.broker is None:
        broker = BrokerAddress("127.0.0.1", free_port(socket.SOCK_STREAM))
    else:
        broker = parse_address(settings.broker)
    workspace = make_workspace(settings, bus, broker, datetime.now(UTC))
    panel = None
    if settings.broker is None and not settings.headless:
        panel = PanelPlace(free_port(socket.SOCK_STREAM), free_port(socket.SOCK_STREAM))
    scene = Venue(bus, broker, workspace, panel)
    if settings.broker is not None:
        await _check_broker(scene)
    return scene


async def _check_broker(scene: Venue) -> None:
    """Make sure that the broker answers, and that the drive's name is free there."""
    try:
        async with conversation(scene.mqtt, DRIVE, end_of(CONNECT_s)):
            pass
    except NoAnswerError as silence:
        raise DemoError(silence.problem) from silence
    with suppress(NoAnswerError):
        status = await read_status(scene.mqtt, DRIVE, RETAINED_s)
        if status.availability == ONLINE.decode():
            raise DemoError(f"broker {scene.broker_text} already has a drive {DRIVE} online")


async def _start(household: Household, settings: DemoSettings, scene: Venue) -> None:
    workspace, configuration = scene.workspace, str(scene.workspace.configuration)
    if settings.broker is None:
        module, log = "adaptdrive_sim.demo.broker_main", workspace.log("broker")
        listeners = [scene.broker_text]
        if scene.panel is not None:
            listeners.append(f"127.0.0.1:{scene.panel.websocket}")
        await household.start("broker", module, listeners, log)
        await _broker_up(household, scene)
    if scene.panel is not None:
        page = [
            "panel",
            "--no-open",
            f"--port={scene.panel.page}",
            f"--broker={scene.panel.broker}",
        ]
        await household.start("panel", "adaptdrive.cli", page, workspace.log("panel"))
    device = [
        "device",
        configuration,
        f"--broker={scene.broker_text}",
        f"--noise={settings.noise_V!r}",
        f"--initial-voltage={REST_BOOST_V}",
    ]
    log = workspace.log("drive")
    await household.start("simulated drive", "adaptdrive_sim", device, log)
    daemon = ["run", configuration]
    await household.start("daemon", "adaptdrive.cli", daemon, workspace.log("daemon"))


async def _broker_up(household: Household, scene: Venue) -> None:
    """Wait until the embedded broker listens."""
    try:
        async with asyncio.timeout(BROKER_s), asyncio.TaskGroup() as tasks:
            watch = tasks.create_task(household.watch())
            await _until_listening(scene.broker)
            watch.cancel()
    except TimeoutError as late:
        raise DemoError(f"the broker does not listen at {scene.broker_text}") from late


async def _until_listening(broker: BrokerAddress) -> None:
    while True:
        try:
            _, writer = await asyncio.open_connection(broker.host, broker.port)
        except OSError:
            await asyncio.sleep(_LOOK_s)
        else:
            writer.close()
            return


async def _play(  # noqa: PLR0913, PLR0917 - everybody on the stage
    household: Household,
    settings: DemoSettings,
    scene: Venue,
    record: DemoRecord,
    show: Show,
    asked: asyncio.Event,
) -> None:
    director = Director(settings, scene.mqtt, record)
    async with asyncio.TaskGroup() as tasks:
        roles = [
            tasks.create_task(household.watch(), name="processes"),
            tasks.create_task(DemoListener(scene.mqtt, DRIVE, record).run(), name="listener"),
            tasks.create_task(director.run(), name="director"),
            tasks.create_task(_show(show, record, scene), name="show"),
            tasks.create_task(_end_in_time(settings, director, asked), name="clock"),
        ]
        await asked.wait()
        for role in roles:
            role.cancel()


async def _show(show: Show, record: DemoRecord, scene: Venue) -> None:
    await show(record, scene)


async def _end_in_time(settings: DemoSettings, director: Director, asked: asyncio.Event) -> None:
    """Ask for the end when the drive has been under control for long enough."""
    if settings.duration_s is not None:
        await director.started.wait()
        await asyncio.sleep(settings.duration_s)
        asked.set()


async def _session_closed(workspace: Workspace) -> None:
    """Wait for the recorder, which closes the session of a daemon that was killed."""
    with suppress(TimeoutError, RecordingError):
        async with asyncio.timeout(SESSION_s):
            while (session := workspace.session()) is not None:
                if read_info(session).ended is not Ending.OPEN:
                    return
                await asyncio.sleep(_LOOK_s)
