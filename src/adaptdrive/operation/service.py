"""The daemon's side of the MQTT contract: reports go out, commands come in."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from aiomqtt import Will

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.archive import Archive
from adaptdrive.operation.board import StateBoard
from adaptdrive.operation.clock import (
    Monotonic,
    Synchronisation,
    WallClock,
    kernel_synchronisation,
    utc_now,
)
from adaptdrive.operation.desk import Desk
from adaptdrive.operation.history import History
from adaptdrive.operation.home_assistant import discovery
from adaptdrive.operation.intake import Intake
from adaptdrive.operation.journal import Journal
from adaptdrive.operation.link import BrokerConnection, BrokerLink
from adaptdrive.operation.messages import OFFLINE
from adaptdrive.operation.name import ClientName
from adaptdrive.operation.pace import BrokerBackoff, LogRation, Pace
from adaptdrive.operation.profile import Profile
from adaptdrive.operation.session import BrokerSession
from adaptdrive.operation.topics import Topics
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.reports import Severity
from adaptdrive.runtime.requests import Host

CLOCK_CHECK_S = 10.0


@dataclass(frozen=True, slots=True)
class ServiceSurroundings:
    """Resources of the machine that the service uses.

    Attributes:
        directory: Where replies and unsent events are kept across restarts.
        wall: Wall clock in UTC.
        monotonic: Clock for intervals, in seconds.
        synchronisation: Returns whether the wall clock can be trusted.
        uniform: Random number between its arguments, for the back-off.
        start_thread: What a thread of the service does first.
    """

    directory: Path
    wall: WallClock = utc_now
    monotonic: Monotonic = time.monotonic
    synchronisation: Callable[[], Synchronisation] = kernel_synchronisation
    uniform: Callable[[float, float], float] = random.uniform
    start_thread: Callable[[], None] = lambda: None


class MqttService:
    """Publishes one drive on a broker and answers its operators."""

    def __init__(
        self,
        profile: Profile,
        settings: Mqtt,
        host: Host,
        hub: Hub,
        surroundings: ServiceSurroundings,
    ) -> None:
        """Subscribe to the hub: nothing is missed between now and `run`.

        Args:
            profile: Name, unit and limits of the drive.
            settings: Section `[mqtt]`.
            host: Carries commands out.
            hub: Where the runtime's reports come from.
            surroundings: Folder, clocks and chance.
        """
        drive = profile.drive
        self._topics = Topics(drive)
        self._announcement = (
            discovery(profile, settings.home_assistant) if settings.home_assistant else None
        )
        self._pace = Pace(1.0 / settings.telemetry_Hz, surroundings.monotonic)
        self._around = surroundings
        self._host = host
        path = surroundings.directory / f"{drive}.operation.sqlite3"
        journal = Journal(path, surroundings.start_thread)
        self._archive = Archive(journal, surroundings.wall, surroundings.monotonic)
        self._board = StateBoard(surroundings.wall, profile, self._archive.trips)
        history, outbox = History(surroundings.monotonic), self._archive.outbox
        self._intake = Intake(
            hub, self._board, outbox, history, wall=surroundings.wall, output=profile.output
        )
        self._desk = self._build_desk(hub)
        self._link = self._build_link(settings, drive)

    def _build_desk(self, hub: Hub) -> Desk:
        return Desk(
            self._host,
            self._archive.replies,
            lambda: self._board.state,
            self._around.wall,
            LogRation(self._around.monotonic),
            report=hub.publish,
            kept=hub.kept,
            shutting_down=lambda: self._board.shutting_down,
        )

    def _build_link(self, settings: Mqtt, drive: str) -> BrokerLink:
        return BrokerLink(
            settings,
            ClientName(f"adaptdrive-{drive}", self._around.monotonic, self._meet_rival),
            Will(self._topics.availability, OFFLINE, qos=1, retain=True),
            BrokerBackoff(self._around.uniform),
            self._around.monotonic,
        )

    async def run(self) -> None:
        """Serve until cancelled, with a broker or without."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._keep_archive(), name="mqtt journal")
                tasks.create_task(self._intake.run(), name="mqtt intake")
                tasks.create_task(self._watch_clock(), name="mqtt clock")
                tasks.create_task(self._desk.run(), name="mqtt desk")
                tasks.create_task(self._keep_connected(), name="mqtt link")
        finally:
            await self._archive.close()

    async def _keep_archive(self) -> None:
        await self._archive.run(self._intake.report, self._board.show_recalled)

    def _meet_rival(self, detail: str, *, certain: bool) -> None:
        """Report another client of the drive's name, and trip where that is certain."""
        cause = (
            f"second broker client: {detail}; likeliest a second daemon for this drive on another "
            "machine: end it"
        )
        self._intake.report("broker", Severity.ALARM, cause)
        if certain:
            self._host.trip(cause)

    async def _watch_clock(self) -> None:
        while True:
            self._board.show_clock(self._around.synchronisation())
            await asyncio.sleep(CLOCK_CHECK_S)

    async def _keep_connected(self) -> None:
        async def serve(line: BrokerConnection) -> None:
            session = BrokerSession(line, self._topics, self._intake, self._desk, self._pace)
            await session.run(self._announcement)

        await self._link.run(serve)
