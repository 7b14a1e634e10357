"""One connection to the broker, from `online` to `offline`."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterator
from contextlib import suppress
from typing import Any

from aiomqtt import Message, MqttError, ProtocolVersion
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from adaptdrive.lines import log
from adaptdrive.operation.board import Mailbox
from adaptdrive.operation.desk import Desk, OperatorCommand
from adaptdrive.operation.intake import Intake
from adaptdrive.operation.link import BrokerConnection
from adaptdrive.operation.messages import OFFLINE, ONLINE, Payload, Reply, encode
from adaptdrive.operation.probe import CommandProbe
from adaptdrive.operation.topics import Topics
from adaptdrive.runtime.reports import Severity, State

COMMANDS_HELD = 100
PAUSE_S = 0.005
"""From one answer to the next command: a flood of them must not keep a CPU busy."""

LOGGED_EVERY_S = 10.0
HISTOGRAMS_EVERY_S = 10.0
HISTORY_EVERY_S = 5.0
ONLINE_EVERY_S = 10.0
"""For the farewell or the last will of another connection, which the broker keeps in its place."""

FAREWELL_S = 1.0
LOWEST_FAILURE_CODE = 128

RESET = "reset"
_OFF_STATES = (State.STANDBY, State.STOPPING)
"""States after a reset in which nothing is energised."""
SHUTTING_DOWN = "the daemon is shutting down"


class BrokerSession:
    """Sends what the intake holds, and hands commands on, over one line."""

    def __init__(
        self,
        line: BrokerConnection,
        topics: Topics,
        intake: Intake,
        desk: Desk,
        telemetry_s: float,
    ) -> None:
        """Send nothing yet.

        Args:
            line: The connection.
            topics: Topics of the drive.
            intake: Reports to send.
            desk: Answers commands.
            telemetry_s: Shortest time between two messages of the fast loop.
        """
        self._line = line
        self._client = line.client
        self._protocol = line.protocol
        self._topics = topics
        self._intake = intake
        self._desk = desk
        self._telemetry_s = telemetry_s
        self._commands: Mailbox[OperatorCommand] = Mailbox(COMMANDS_HELD)
        self._stops: Mailbox[OperatorCommand] = Mailbox(COMMANDS_HELD)
        self._asked = asyncio.Event()
        self._probe = CommandProbe(line.client, topics.probe, intake)
        self._refused: set[str] = set()
        self._logged = 0
        self._logged_s = -LOGGED_EVERY_S

    async def run(self, announcement: tuple[str, Payload] | None = None) -> None:
        """Serve until the connection is lost, or until cancelled: then publish that and leave.

        Args:
            announcement: Topic and payload of a retained message more, None for none.

        Raises:
            MqttError: The connection is lost.
        """
        try:
            await self._greet()
            if announcement is not None:
                topic, payload = announcement
                await self._client.publish(topic, encode(payload), qos=1, retain=True)
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._client.lost(), name="mqtt connection")
                tasks.create_task(self._answer_commands(), name="mqtt replies")
                tasks.create_task(self._answer_stops(), name="mqtt stops")
                tasks.create_task(self._send_state(), name="mqtt state")
                tasks.create_task(self._repeat_online(), name="mqtt availability")
                tasks.create_task(self._send_events(), name="mqtt events")
                for name, sending in self._telemetry():
                    tasks.create_task(sending, name=f"mqtt telemetry/{name}")
                tasks.create_task(self._send_history(), name="mqtt history")
                if self._can_probe:
                    tasks.create_task(self._probe.run(), name="mqtt probe")
        except asyncio.CancelledError:
            await self._take_leave()
            raise

    @property
    def _can_probe(self) -> bool:
        allowed = self._topics.probe not in self._refused
        return allowed and self._protocol is ProtocolVersion.V5

    async def _greet(self) -> None:
        self._intake.forget_telemetry()
        self._client.receive_with(self._receive)
        await self._subscribe()
        await self._publish_state()
        await self._publish_online()

    async def _publish_online(self) -> None:
        await self._client.publish(self._topics.availability, ONLINE, qos=1, retain=True)

    async def _repeat_online(self) -> None:
        while True:
            await asyncio.sleep(ONLINE_EVERY_S)
            await self._publish_online()

    async def _subscribe(self) -> None:
        for topic, wishes in self._subscriptions():
            for code in await self._client.subscribe(topic, **wishes):
                value = code.value if isinstance(code, ReasonCode) else code
                if value >= LOWEST_FAILURE_CODE:
                    self._refused.add(topic)
                    self._report_refusal(topic, str(code))

    def _subscriptions(self) -> Iterator[tuple[str, dict[str, Any]]]:
        topics = [self._topics.commands, self._topics.ask_history]
        if self._protocol is not ProtocolVersion.V5:
            yield from ((topic, {"qos": 1}) for topic in topics)
            return
        if self._line.name.given_way:  # what it publishes itself does not come back
            topics.append(self._topics.drive_telemetry)
        foreign = SubscribeOptions(qos=1, retainAsPublished=True, noLocal=True)
        yield from ((topic, {"options": foreign}) for topic in topics)
        yield self._topics.probe, {"qos": 1}  # with what it publishes itself

    def _report_refusal(self, topic: str, code: str) -> None:
        """Log a refused subscription, and report it where no command arrives without it."""
        log("error", "broker does not allow to subscribe", topic=topic, code=code)
        if topic == self._topics.commands:
            self._intake.report(
                "broker",
                Severity.ALARM,
                f"no commands: the broker refuses the subscription to {topic} ({code}); no command "
                "arrives over MQTT, no disable either: give this daemon's user the right to read "
                "that topic",
            )

    async def _publish_state(self) -> None:
        if (message := self._intake.board.message) is not None:
            await self._client.publish(self._topics.state, encode(message), qos=1, retain=True)

    def _receive(self, message: Message) -> None:
        if self._probe.takes(message):
            return
        if message.topic.value == self._topics.drive_telemetry:
            self._line.name.heard_rival()
            return
        if message.topic.value == self._topics.ask_history:
            self._asked.set()
            return
        verb = self._topics.verb(message.topic.value)
        command = self._desk.receive(verb, bytes(message.payload), retained=message.retain)
        (self._commands if command.stopped is None else self._stops).put(command)

    async def _answer_commands(self) -> None:
        while True:
            reply = await self._desk.ask(await self._commands.take())
            await self._reply(reply)
            self._log_dropped()
            if reply.accepted and reply.verb == RESET and reply.state in _OFF_STATES:
                self._line.name.reclaim(self._client)  # nothing is heard until it has connected
            await asyncio.sleep(PAUSE_S)

    async def _answer_stops(self) -> None:
        while True:
            command = await self._stops.take()
            if command.remains_on_broker:
                await self._clear_retained_stop()
            await self._reply(await self._desk.answer(command))
            await asyncio.sleep(PAUSE_S)

    async def _clear_retained_stop(self) -> None:
        """Delete a stop that the broker would deliver again at each connection."""
        await self._client.publish(self._topics.stop, b"", qos=1, retain=True)
        self._intake.report(
            "command",
            Severity.WARNING,
            f"a retained disable on {self._topics.stop} was carried out, and the broker was asked "
            "to delete it, so that it does not stop the drive again at the next connection; "
            "publish disable without retain",
        )

    async def _reply(self, reply: Reply) -> None:
        await self._client.publish(self._topics.reply, encode(reply), qos=1)

    def _log_dropped(self) -> None:
        """Log that commands went unread, and how many, but not each."""
        now_s = asyncio.get_running_loop().time()
        dropped = self._commands.dropped + self._stops.dropped
        if dropped == self._logged or now_s - self._logged_s < LOGGED_EVERY_S:
            return
        log("warning", "too many commands", dropped=dropped - self._logged)
        self._logged, self._logged_s = dropped, now_s

    async def _send_state(self) -> None:
        while True:
            await self._intake.board.change()
            await self._publish_state()

    async def _send_events(self) -> None:
        while True:
            await self._send_oldest_event()

    async def _send_oldest_event(self) -> None:
        body = await self._intake.outbox.oldest()
        await self._client.publish(self._topics.event, body, qos=1)
        self._intake.outbox.sent(body)
        self._intake.report_discarded()

    async def _send_telemetry(
        self, box: Mailbox[Payload], topic: str, pause_s: float, *, retain: bool = True
    ) -> None:
        while True:
            message = await box.take()
            await self._client.publish(topic, encode(message), retain=retain)
            await asyncio.sleep(pause_s)

    def _telemetry(self) -> Iterator[tuple[str, Coroutine[Any, Any, None]]]:
        """Yield what sends each kind of telemetry."""
        send, intake, topics = self._send_telemetry, self._intake, self._topics
        yield "load", send(intake.load, topics.load_telemetry, 0.0)
        yield "drive", send(intake.drive, topics.drive_telemetry, self._telemetry_s, retain=False)
        yield "histograms", send(intake.histograms, topics.histograms, HISTOGRAMS_EVERY_S)

    async def _send_history(self) -> None:
        """Answer all requests of the meantime at once; every client can read the answer."""
        while True:
            await self._asked.wait()
            self._asked.clear()
            for page in self._intake.history_pages():
                await self._client.publish(self._topics.history, encode(page), qos=1)
                await asyncio.sleep(PAUSE_S)
            await asyncio.sleep(HISTORY_EVERY_S)

    async def _take_leave(self) -> None:
        """Publish the end while commands are still answered: all but a stop are refused."""
        try:
            async with asyncio.TaskGroup() as tasks:
                answering = [
                    tasks.create_task(self._refuse_commands(), name="mqtt refusals"),
                    tasks.create_task(self._answer_stops(), name="mqtt stops"),
                ]
                await self._say_offline()
                for task in answering:
                    task.cancel()
        except* MqttError:
            pass

    async def _refuse_commands(self) -> None:
        while True:
            await self._reply(self._desk.refuse(await self._commands.take(), SHUTTING_DOWN))
            await asyncio.sleep(PAUSE_S)

    async def _say_offline(self) -> None:
        """Send what is left, then `offline`; each only as long as the broker plays along."""
        self._intake.catch_up()
        with suppress(MqttError, TimeoutError):
            async with asyncio.timeout(FAREWELL_S):
                await self._publish_state()
                while len(self._intake.outbox):
                    await self._send_oldest_event()
        with suppress(MqttError, TimeoutError):
            async with asyncio.timeout(FAREWELL_S):
                await self._client.publish(self._topics.availability, OFFLINE, qos=1, retain=True)
