"""Hearing the drive and its simulator over MQTT, as any operator would."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import NoReturn, TypeVar

import msgspec
from aiomqtt import Client, Message, MqttError, ProtocolVersion

from adaptdrive.config.services import Mqtt
from adaptdrive.errors import NOT_JSON
from adaptdrive.operation.link import connection
from adaptdrive.operation.messages import ONLINE
from adaptdrive.operation.simulator import simulator_topic
from adaptdrive.operation.topics import Topics
from adaptdrive_sim.demo import heard
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.settings import DemoError

_RETRY_s = 0.5

Take = Callable[[bytes], None]
Payload = TypeVar("Payload")


class DemoListener:
    """Fills a record with the messages of a drive."""

    def __init__(self, broker: Mqtt, drive: str, record: DemoRecord) -> None:
        """Prepare to listen.

        Args:
            broker: Where the broker is.
            drive: Name of the drive.
            record: Filled.
        """
        self._broker = broker
        self._record = record
        topics = Topics(drive)
        self._takes: dict[str, Take] = {
            topics.availability: self._hear_availability,
            topics.state: _reading(heard.StateMessage, record.hear_state),
            topics.drive_telemetry: _reading(heard.DriveMessage, record.hear_drive),
            topics.load_telemetry: _reading(heard.LoadMessage, record.hear_load),
            topics.event: _reading(heard.EventMessage, record.hear_event),
            simulator_topic(drive, "truth"): _reading(heard.Truth, record.hear_truth),
        }

    async def run(self) -> NoReturn:
        """Listen until cancelled; a broker that is lost is asked again.

        Raises:
            DemoError: A message does not obey the contract.
        """
        while True:
            try:
                await self._listen()
            except (MqttError, OSError, TimeoutError):
                self._record.connected = False
            await asyncio.sleep(_RETRY_s)

    async def _listen(self) -> None:
        async with connection(self._broker, ProtocolVersion.V311, None, None) as client:
            await self._subscribe(client)
            self._record.connected = True
            async for message in client.messages:
                self._take(message)

    async def _subscribe(self, client: Client) -> None:
        for topic in self._takes:
            await client.subscribe(topic, qos=1)

    def _take(self, message: Message) -> None:
        payload = bytes(message.payload)
        if not payload:  # that only ends a retained message
            return
        try:
            self._takes[message.topic.value](payload)
        except NOT_JSON as problem:
            raise DemoError(f"{message.topic}: cannot be read: {problem}") from problem

    def _hear_availability(self, payload: bytes) -> None:
        self._record.online = payload == ONLINE


def _reading(kind: type[Payload], take: Callable[[Payload], None]) -> Take:
    decoder = msgspec.json.Decoder(kind)
    return lambda payload: take(decoder.decode(payload))
