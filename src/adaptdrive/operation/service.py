"""The daemon's side of the MQTT contract: reports go out, commands come in."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from dataclasses import dataclass

from aiomqtt import Will

from adaptdrive.config.services import Mqtt
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
from adaptdrive.operation.ledger import Ledger
from adaptdrive.operation.link import BrokerConnection, BrokerLink
from adaptdrive.operation.memory import ReplyMemory
from adaptdrive.operation.messages import OFFLINE, LastTrip, encode, event_message
from adaptdrive.operation.name import ClientName
from adaptdrive.operation.outbox import Outbox
from adaptdrive.operation.pace import BrokerBackoff, LogRation
from adaptdrive.operation.profile import Profile
from adaptdrive.operation.session import BrokerSession
from adaptdrive.operation.topics import Topics
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.reports import Severity
from adaptdrive.runtime.requests import Host
from adaptdrive.runtime.trips import remedy

CLOCK_CHECK_S = 10.0
COMMAND_PATIENCE_S = 1.0
"""Longest wait of a command for the disk: one that hangs must not keep an operator from acting."""


@dataclass(frozen=True, slots=True)
class ServiceSurroundings:
    """Resources of the machine that the service uses.

    Attributes:
        ledger: What survives restarts.
        wall: Wall clock in UTC.
        monotonic: Clock for intervals, in seconds.
        synchronisation: Returns whether the wall clock can be trusted.
        uniform: Random number between its arguments, for the back-off.
    """

    ledger: Ledger
    wall: WallClock = utc_now
    monotonic: Monotonic = time.monotonic
    synchronisation: Callable[[], Synchronisation] = kernel_synchronisation
    uniform: Callable[[float, float], float] = random.uniform


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
            surroundings: Ledger, clocks and chance.
        """
        drive = profile.drive
        self._topics = Topics(drive)
        self._announcement = (
            discovery(profile, settings.home_assistant) if settings.home_assistant else None
        )
        self._telemetry_s = 1.0 / settings.telemetry_Hz
        self._around = surroundings
        self._host = host
        ledger, wall = surroundings.ledger, surroundings.wall
        trip = LastTrip(*ledger.trip, remedy(ledger.trip[1])) if ledger.trip else None
        self._board = StateBoard(wall, profile, trip)
        unsent = (encode(event_message(event, time)) for time, event in ledger.events)
        outbox, history = Outbox(unsent, ledger.note_sent), History(surroundings.monotonic)
        self._intake = Intake(hub, self._board, outbox, history, wall=wall, output=profile.output)
        self._desk = self._build_desk(hub)
        self._link = self._build_link(settings, drive)

    def _build_desk(self, hub: Hub) -> Desk:
        ledger, monotonic = self._around.ledger, self._around.monotonic
        return Desk(
            self._host,
            ReplyMemory(ledger.replies, ledger.note_reply, monotonic),
            lambda: self._board.state,
            self._around.wall,
            LogRation(monotonic),
            report=hub.publish,
            kept=lambda: ledger.kept(COMMAND_PATIENCE_S),
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
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._intake.run(), name="mqtt intake")
            tasks.create_task(self._watch_clock(), name="mqtt clock")
            tasks.create_task(self._desk.run(), name="mqtt desk")
            tasks.create_task(self._keep_connected(), name="mqtt link")

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
            pause_s = self._telemetry_s
            session = BrokerSession(line, self._topics, self._intake, self._desk, pause_s)
            await session.run(self._announcement)

        await self._link.run(serve)
