"""The daemon's side of the MQTT contract: reports go out, commands come in."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial

from aiomqtt import Will

from adaptdrive.config.services import Mqtt
from adaptdrive.mqtt.clock import (
    BrokerBackoff,
    LogRation,
    Monotonic,
    Synchronisation,
    WallClock,
    kernel_synchronisation,
    utc_now,
)
from adaptdrive.mqtt.connection import BrokerLink, ClientName
from adaptdrive.mqtt.contract import OFFLINE, LastTrip, Profile, Topics, encode, event_message
from adaptdrive.mqtt.desk import Desk, Recalled, ReplyMemory
from adaptdrive.mqtt.discovery import discovery
from adaptdrive.mqtt.publisher import History, Intake, Outbox, StateBoard
from adaptdrive.mqtt.session import BrokerSession
from adaptdrive.mqtt.steady import SteadyClient
from adaptdrive.runtime.reports import Event, Hub, Severity
from adaptdrive.runtime.requests import Host
from adaptdrive.runtime.trips import remedy
from adaptdrive.util.threads import repeat

CLOCK_CHECK_S = 10.0
COMMAND_PATIENCE_S = 1.0
"""Longest wait of a command for the disk: one that hangs must not keep an operator from acting."""


async def _wait_for_nothing(_patience_s: float) -> None:
    pass


@dataclass(frozen=True, slots=True)
class ServiceSurroundings:
    """The log as the service sees it, by default one that keeps nothing, and clocks and chance.

    Attributes:
        replies: Replies of earlier runs, the oldest first.
        events: Time and contents of the events that the broker does not have, the oldest first.
        trip: Time and text of the last trip, None before the first.
        note_reply: Has a reply kept by its id.
        note_sent: Has it kept that the broker has the oldest event.
        kept: Waits until the disk keeps what was noted and published, for a longest time in s.
        wall: Wall clock in UTC.
        monotonic: Clock for intervals, in seconds.
        synchronisation: Returns whether the wall clock can be trusted.
        uniform: Random number between its arguments, for the back-off.
    """

    replies: Sequence[Recalled] = ()
    events: Sequence[tuple[datetime, Event]] = ()
    trip: tuple[datetime, str] | None = None
    note_reply: Callable[[str, bytes], None] = lambda _identity, _body: None
    note_sent: Callable[[], None] = lambda: None
    kept: Callable[[float], Awaitable[None]] = _wait_for_nothing
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
            surroundings: Log, clocks and chance.
        """
        drive = profile.drive
        self._topics = Topics(drive)
        self._announcement = (
            discovery(profile, settings.home_assistant) if settings.home_assistant else None
        )
        self._telemetry_s = 1.0 / settings.telemetry_Hz
        self._around = surroundings
        self._host = host
        tripped, wall = surroundings.trip, surroundings.wall
        trip = LastTrip(*tripped, remedy(tripped[1])) if tripped else None
        self._board = StateBoard(wall, profile, trip)
        unsent = (encode(event_message(event, time)) for time, event in surroundings.events)
        outbox, history = Outbox(unsent, surroundings.note_sent), History(surroundings.monotonic)
        self._intake = Intake(hub, self._board, outbox, history, wall, profile.output)
        self._desk = self._build_desk(hub)
        alarm = partial(self._intake.report, "broker", Severity.ALARM)
        self._name = ClientName(f"adaptdrive-{drive}", surroundings.monotonic, alarm, host.trip)
        self._link = self._build_link(settings)

    def _build_desk(self, hub: Hub) -> Desk:
        around = self._around
        return Desk(
            self._host,
            ReplyMemory(around.replies, around.note_reply, around.monotonic),
            lambda: self._board.state,
            around.wall,
            LogRation(around.monotonic),
            report=hub.publish,
            kept=lambda: around.kept(COMMAND_PATIENCE_S),
            shutting_down=lambda: self._board.shutting_down,
        )

    def _build_link(self, settings: Mqtt) -> BrokerLink:
        return BrokerLink(
            settings,
            self._name,
            Will(self._topics.availability, OFFLINE, qos=1, retain=True),
            BrokerBackoff(self._around.uniform),
        )

    async def run(self) -> None:
        """Serve until cancelled, with a broker or without."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._intake.run(), name="mqtt intake")
            tasks.create_task(repeat(self._read_clock, CLOCK_CHECK_S), name="mqtt clock")
            tasks.create_task(self._desk.run(), name="mqtt desk")
            tasks.create_task(self._link.run(self._serve), name="mqtt link")

    async def _read_clock(self) -> None:
        self._board.show_clock(self._around.synchronisation())

    async def _serve(self, client: SteadyClient) -> None:
        session = BrokerSession(
            client, self._name, self._topics, self._intake, self._desk, self._telemetry_s
        )
        await session.run(self._announcement)
