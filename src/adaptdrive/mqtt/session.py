"""One connection of the daemon to the broker, from `online` to `offline`.

mosquitto accepts a subscription to topics which its access list does not let the daemon read, and
delivers nothing. No answer shows that, and a drive would run on whatever an operator asks for.
"""

import asyncio
import secrets
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from aiomqtt import Message, MqttError, ProtocolVersion
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from adaptdrive.mqtt import connection, contract, publisher, steady
from adaptdrive.mqtt.desk import Desk, LineRation, OperatorCommand
from adaptdrive.runtime.reports import Queue, Severity, State
from adaptdrive.util.clock import Step, repeat
from adaptdrive.util.lines import write_line

PROBE_EVERY_S = 60.0
PATIENCE_S = 10.0
"""Longest way of a message to the broker and back."""

COMMANDS_HELD = 100
PAUSE_S = 0.005
"""From one answer to the next command: a flood of them must not keep a CPU busy."""

WRITTEN_EVERY_S = 10.0
HISTOGRAMS_EVERY_S = 10.0
HISTORY_EVERY_S = 5.0
ONLINE_EVERY_S = 10.0
"""For the `offline` or the last will of another connection, which the broker keeps in its place."""

OFFLINE_S = 1.0
LOWEST_FAILURE_CODE = 128

RESET = "reset"
_OFF_STATES = (State.STANDBY, State.STOPPING)
"""States after a reset in which nothing is energised."""
SHUTTING_DOWN = "the daemon is shutting down"


@dataclass
class BrokerSession:
    """Sends what the intake holds, and hands commands on, over one connection.

    Attributes:
        client: The connected client.
        name: Its name at the broker.
        topics: Topics of the drive.
        intake: Reports to send.
        desk: Answers commands.
        telemetry_s: Shortest time between two messages of the fast loop.
    """

    client: steady.SteadyClient
    name: connection.ClientName
    topics: contract.Topics
    intake: publisher.Intake
    desk: Desk
    telemetry_s: float

    def __post_init__(self) -> None:
        self._commands: Queue[OperatorCommand] = Queue(COMMANDS_HELD)
        self._stops: Queue[OperatorCommand] = Queue(COMMANDS_HELD)
        self._asked = asyncio.Event()
        self._token = secrets.token_hex(8).encode()
        self._arrived = asyncio.Event()
        self._commands_lost = False
        self._refused: set[str] = set()
        self._reported = 0
        self._ration = LineRation(asyncio.get_running_loop().time, 1, WRITTEN_EVERY_S)

    async def run(self, announcement: tuple[str, contract.Payload] | None = None) -> None:
        """Serve until the connection is lost, or until cancelled: then publish that and leave.

        Args:
            announcement: Topic and payload of a retained message more, None for none.

        Raises:
            MqttError: The connection is lost.
        """
        try:
            self.intake.forget_telemetry()
            self.client.receive = self._receive
            await self._subscribe()
            await self._publish_state()
            if announcement is not None:
                topic, payload = announcement
                await self._leave(topic, contract.encode(payload))
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self.client.lost(), name="mqtt connection")
                for name, step, pause_s in self._work():
                    tasks.create_task(repeat(step, pause_s), name=f"mqtt {name}")
        except asyncio.CancelledError:
            await self._end()
            raise

    def _work(self) -> Iterator[tuple[str, Step, float]]:
        """Yield what is done again and again, and the pause after each time."""
        intake, topics = self.intake, self.topics
        online = partial(self._leave, topics.availability, contract.ONLINE)
        yield "availability", online, ONLINE_EVERY_S
        yield "replies", self._answer_command, PAUSE_S
        yield "stops", self._answer_stop, PAUSE_S
        yield "state", self._send_state, 0.0
        yield "events", self._send_oldest_event, 0.0
        yield "load", partial(self._send, intake.load, topics.load_telemetry), 0.0
        fast = partial(self._send, intake.drive, topics.drive_telemetry, retain=False)
        yield "drive", fast, self.telemetry_s
        counts = partial(self._send, intake.histograms, topics.histograms)
        yield "health", partial(self._send, intake.health, topics.health), 0.0
        yield "histograms", counts, HISTOGRAMS_EVERY_S
        yield "history", self._send_history, HISTORY_EVERY_S
        if topics.probe not in self._refused and self.client.protocol is ProtocolVersion.V5:
            yield "probe", self._probe, PROBE_EVERY_S

    async def _probe(self) -> None:
        """Look once whether commands arrive: a message to a topic among them must come back.

        A broker that does not take it, as one with an older access list, shows nothing; nor does
        one of MQTT 3.1.1, which does not answer whether it takes a message.
        """
        self._arrived.clear()
        if not await self.client.offer(self.topics.probe, self._token):
            return
        with suppress(TimeoutError):
            async with asyncio.timeout(PATIENCE_S):
                await self._arrived.wait()
        lost, self._commands_lost = self._commands_lost, not self._arrived.is_set()
        if self._commands_lost and not lost:
            self.intake.report_no_commands(
                f"the broker has taken a message to {self.topics.probe} and does not deliver it to "
                f"this daemon within {PATIENCE_S:g} s"
            )
        elif lost and not self._commands_lost:
            self.intake.report("broker", Severity.INFO, "commands arrive again")

    async def _leave(self, topic: str, payload: bytes) -> None:
        """Publish a message that the broker keeps."""
        await self.client.publish(topic, payload, qos=1, retain=True)

    async def _subscribe(self) -> None:
        """Subscribe; write what is refused, and report it where no command arrives without it."""
        for topic, wishes in self._subscriptions():
            for code in await self.client.subscribe(topic, **wishes):
                value = code.value if isinstance(code, ReasonCode) else code
                if value >= LOWEST_FAILURE_CODE:
                    self._refused.add(topic)
                    write_line(
                        "error", "broker does not allow to subscribe", topic=topic, code=str(code)
                    )
                    if topic == self.topics.commands:
                        refused = f"the broker refuses the subscription to {topic} ({code})"
                        self.intake.report_no_commands(refused)

    def _subscriptions(self) -> Iterator[tuple[str, dict[str, Any]]]:
        topics = [self.topics.commands, self.topics.ask_history]
        if self.client.protocol is not ProtocolVersion.V5:
            yield from ((topic, {"qos": 1}) for topic in topics)
            return
        if self.name.is_displaced:  # what it publishes itself does not come back
            topics.append(self.topics.drive_telemetry)
        foreign = SubscribeOptions(qos=1, retainAsPublished=True, noLocal=True)
        yield from ((topic, {"options": foreign}) for topic in topics)
        yield self.topics.probe, {"qos": 1}  # with what it publishes itself

    async def _publish_state(self) -> None:
        if (message := self.intake.board.message) is not None:
            await self._leave(self.topics.state, contract.encode(message))

    def _receive(self, message: Message) -> None:
        match message.topic.value:
            case self.topics.probe if message.payload == self._token:
                self._arrived.set()
            case self.topics.drive_telemetry:
                self.name.note_other_publisher()
            case self.topics.ask_history:
                self._asked.set()
            case topic:
                verb, payload = self.topics.verb(topic), bytes(message.payload)
                command = self.desk.receive(verb, payload, retained=message.retain)
                (self._commands if command.stopped is None else self._stops).put(command)

    async def _answer_command(self) -> None:
        reply = await self.desk.ask(await self._commands.take_oldest())
        await self._reply(reply)
        self._log_dropped()
        if reply.accepted and reply.verb == RESET and reply.state in _OFF_STATES:
            self.name.reclaim(self.client)  # nothing arrives until it has connected

    async def _answer_stop(self) -> None:
        command = await self._stops.take_oldest()
        if command.remains_on_broker:
            await self._clear_retained_stop()
        await self._reply(await self.desk.answer(command))

    async def _clear_retained_stop(self) -> None:
        """Delete a stop that the broker would deliver again at each connection."""
        await self._leave(self.topics.stop, b"")
        self.intake.report(
            "command",
            Severity.WARNING,
            f"a retained disable on {self.topics.stop} was carried out, and the broker was asked "
            "to delete it, so that it does not stop the drive again at the next connection; "
            "publish disable without retain",
        )

    async def _reply(self, reply: contract.Reply) -> None:
        await self.client.publish(self.topics.reply, contract.encode(reply), qos=1)

    def _log_dropped(self) -> None:
        """Write that commands went unread, and how many, but not each."""
        dropped = self._commands.dropped + self._stops.dropped
        if dropped > self._reported and self._ration.take() is not None:
            write_line("warning", "too many commands", dropped=dropped - self._reported)
            self._reported = dropped

    async def _send_state(self) -> None:
        await self.intake.board.change()
        await self._publish_state()

    async def _send_oldest_event(self) -> None:
        body = await self.intake.outbox.oldest()
        await self.client.publish(self.topics.event, body, qos=1)
        self.intake.outbox.sent(body)
        self.intake.report_discarded()

    async def _send(self, box: Queue[contract.Payload], topic: str, *, retain: bool = True) -> None:
        await self.client.publish(topic, contract.encode(await box.take_oldest()), retain=retain)

    async def _send_history(self) -> None:
        """Answer all requests of the meantime at once; every client can read the answer."""
        await self._asked.wait()
        self._asked.clear()
        for page in self.intake.history.pages(self.intake.wall()):
            await self.client.publish(self.topics.history, contract.encode(page), qos=1)
            await asyncio.sleep(PAUSE_S)

    async def _end(self) -> None:
        """Publish the end while commands are still answered: all but a stop are refused."""
        try:
            async with asyncio.TaskGroup() as tasks:
                answering = [
                    tasks.create_task(repeat(step, PAUSE_S), name="mqtt end")
                    for step in (self._refuse_command, self._answer_stop)
                ]
                await self._send_offline()
                for task in answering:
                    task.cancel()
        except* MqttError:
            pass

    async def _refuse_command(self) -> None:
        await self._reply(self.desk.refuse(await self._commands.take_oldest(), SHUTTING_DOWN))

    async def _send_offline(self) -> None:
        """Send what is left, then `offline`; each only as long as the broker plays along."""
        self.intake.catch_up()
        with suppress(MqttError, TimeoutError):
            async with asyncio.timeout(OFFLINE_S):
                await self._publish_state()
                while len(self.intake.outbox):
                    await self._send_oldest_event()
        with suppress(MqttError, TimeoutError):
            async with asyncio.timeout(OFFLINE_S):
                await self._leave(self.topics.availability, contract.OFFLINE)
