"""One connection to the broker, from greeting to farewell."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

import structlog
from aiomqtt import Message, MqttError, ProtocolVersion
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from adaptdrive.operation.intake import Intake
from adaptdrive.operation.link import Line
from adaptdrive.operation.messages import OFFLINE, ONLINE, Reply, encode
from adaptdrive.operation.pace import Pace
from adaptdrive.operation.topics import Topics

COMMANDS_HELD = 10
PAUSE_S = 0.005
"""From one answer to the next command: a flood of them must not keep a CPU busy."""

TOLD_EVERY_S = 10.0
FAREWELL_S = 1.0
LOWEST_FAILURE_CODE = 128

Ask = Callable[[str, bytes, bool], Awaitable[Reply | None]]
"""Has a command answered: verb, payload, whether it was retained."""


class Session:
    """Sends what the intake holds, and hands commands on, over one line."""

    def __init__(
        self,
        line: Line,
        topics: Topics,
        intake: Intake,
        ask: Ask,
        pace: Pace,
    ) -> None:
        self._client = line.client
        self._protocol = line.protocol
        self._topics = topics
        self._intake = intake
        self._ask = ask
        self._pace = pace
        self._commands: asyncio.Queue[Message] = asyncio.Queue(COMMANDS_HELD)
        self._told = 0
        self._told_s = -TOLD_EVERY_S

    async def run(self) -> None:
        """Serve until the connection is lost, or until cancelled: then say so and leave.

        Raises:
            MqttError: The connection is lost.
        """
        try:
            await self._greet()
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._take_commands(), name="mqtt commands")
                tasks.create_task(self._answer_commands(), name="mqtt replies")
                tasks.create_task(self._send_state(), name="mqtt state")
                tasks.create_task(self._send_events(), name="mqtt events")
                tasks.create_task(self._send_load(), name="mqtt telemetry/load")
                tasks.create_task(self._send_drive(), name="mqtt telemetry/drive")
        except asyncio.CancelledError:
            await self._take_leave()
            raise

    async def _greet(self) -> None:
        self._intake.forget_telemetry()
        await self._subscribe()
        await self._publish_state()
        await self._client.publish(self._topics.availability, ONLINE, qos=1, retain=True)

    async def _subscribe(self) -> None:
        if self._protocol is ProtocolVersion.V5:
            options = SubscribeOptions(qos=1, retainAsPublished=True)
            granted = await self._client.subscribe(self._topics.commands, options=options)
        else:
            granted = await self._client.subscribe(self._topics.commands, qos=1)
        for code in granted:
            value = code.value if isinstance(code, ReasonCode) else code
            if value >= LOWEST_FAILURE_CODE:
                structlog.get_logger().error(
                    "broker does not allow commands", topic=self._topics.commands, code=str(code)
                )

    async def _publish_state(self) -> None:
        if (message := self._intake.board.message) is not None:
            await self._client.publish(self._topics.state, encode(message), qos=1, retain=True)

    async def _take_commands(self) -> None:
        # Apart from the answering: this is where a lost connection shows at once.
        async for message in self._client.messages:
            await self._commands.put(message)

    async def _answer_commands(self) -> None:
        while True:
            await self._answer(await self._commands.get())
            self._tell_dropped()
            await asyncio.sleep(PAUSE_S)

    async def _answer(self, message: Message) -> None:
        verb = self._topics.verb(message.topic.value)
        reply = await self._ask(verb, bytes(message.payload), message.retain)
        if reply is not None:
            await self._client.publish(self._topics.reply, encode(reply), qos=1)

    def _tell_dropped(self) -> None:
        """Log that commands went unread, and how many, but not each."""
        now_s, dropped = asyncio.get_running_loop().time(), self._client.dropped
        if dropped == self._told or now_s - self._told_s < TOLD_EVERY_S:
            return
        structlog.get_logger().warning("too many commands", dropped=dropped - self._told)
        self._told, self._told_s = dropped, now_s

    async def _send_state(self) -> None:
        while True:
            await self._intake.board.change()
            await self._publish_state()

    async def _send_events(self) -> None:
        while True:
            await self._send_oldest_event()

    async def _send_oldest_event(self) -> None:
        sequence, body = await self._intake.outbox.oldest()
        await self._client.publish(self._topics.event, body, qos=1)
        self._intake.outbox.sent(sequence)

    async def _send_load(self) -> None:
        while True:
            message = await self._intake.load.take()
            await self._client.publish(self._topics.load_telemetry, encode(message))

    async def _send_drive(self) -> None:
        while True:
            message = await self._intake.drive.take()
            await self._pace.wait()
            await self._client.publish(self._topics.drive_telemetry, encode(message))

    async def _take_leave(self) -> None:
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
