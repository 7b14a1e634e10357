"""A broker in this process: the clients of `adaptdrive.mqtt` talk to it without a socket.

It takes the place of the MQTT library under `SteadyClient`. What it does is what mosquitto does:
it keeps retained messages, passes on the flag of live ones as a subscription of MQTT 5 asks for,
publishes last wills, and gives a name to its newest client. Scenes hold the same with mosquitto.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NoReturn, Self

import pytest
from aiomqtt import Message, MqttError, ProtocolVersion, Will
from aiomqtt.exceptions import MqttConnectError

V311, V5 = ProtocolVersion.V311, ProtocolVersion.V5
NOT_AUTHORISED = 135


async def _found(*_: object) -> None:
    """Look no host up."""


@dataclass(eq=False)
class MemoryBroker:
    """Passes messages on.

    Attributes:
        away: Whether nobody can connect.
        hangs: Whether it answers nothing.
        protocols: Versions that it knows.
        refused: Topics to which nobody may subscribe.
        withheld: Topics of which it delivers nothing, although it takes subscriptions to them.
        unwanted: Topics of offers that it does not take.
        names: Names with which clients have connected, one after the other.
    """

    away: bool = False
    hangs: bool = False
    protocols: Sequence[ProtocolVersion] = (V311, V5)
    refused: Sequence[str] = ()
    withheld: Sequence[str] = ()
    unwanted: Sequence[str] = ()
    names: list[str] = field(default_factory=list)
    clients: list[MemoryClient] = field(default_factory=list)
    retained: dict[str, Message] = field(default_factory=dict)

    @contextmanager
    def joined(self) -> Iterator[None]:
        """Have every client of the product connect here."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("adaptdrive.mqtt.connection.SteadyClient", partial(MemoryClient, self))
            patch.setattr("adaptdrive.util.clock.find", _found)
            yield

    def kill(self) -> None:
        """End, with all that was retained."""
        self.away = True
        self.retained.clear()
        for client in tuple(self.clients):
            client.end("the broker is gone", taken_over=False)

    def restart(self) -> None:
        self.away = False

    def take(self, client: MemoryClient) -> None:
        """Have a client join; one of the same name loses its connection."""
        for other in tuple(self.clients):
            if client.identifier is not None and other.identifier == client.identifier:
                other.end("session taken over", taken_over=True)
        if client.identifier is not None:
            self.names.append(client.identifier)
        self.clients.append(client)

    def publish(
        self,
        topic: str,
        payload: bytes,
        *,
        qos: int = 1,
        retain: bool = False,
        sender: MemoryClient | None = None,
    ) -> None:
        if retain:
            self.retained.pop(topic, None)
            if payload:
                self.retained[topic] = Message(topic, payload, qos, True, 0, None)
        if topic in self.withheld:
            return
        for client in tuple(self.clients):
            client.hear(Message(topic, payload, qos, retain, 0, None), sender)


class MemoryClient:
    """What the product uses of `SteadyClient`."""

    def __init__(
        self,
        broker: MemoryBroker,
        *_: object,
        identifier: str | None = None,
        will: Will | None = None,
        protocol: ProtocolVersion = V311,
        timeout: float = 10.0,
        **__: object,
    ) -> None:
        self.broker, self.identifier, self.protocol = broker, identifier, protocol
        self.receive: Callable[[Message], None] | None = None
        self.taken_over = self.closed_by_broker = False
        self._will, self._timeout_s = will, timeout
        self._filters: dict[str, Any] = {}
        self._queue: asyncio.Queue[Message] = asyncio.Queue()
        self._given_up = asyncio.Event()
        self._lost: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    async def __aenter__(self) -> Self:
        if self.broker.hangs:
            await self._answer(self._given_up.wait())
        if self.broker.away:
            raise MqttError("connection refused")
        if self.protocol not in self.broker.protocols:
            raise MqttConnectError(1)
        self.broker.take(self)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._respond()
        self._will = None
        self._leave()

    async def release(self) -> None:
        self._leave()

    def cancel_connecting(self) -> None:
        self._given_up.set()

    async def subscribe(self, topic: Any, *, qos: int = 0, options: Any = None) -> list[int]:
        await self._respond()
        wanted = [topic] if isinstance(topic, str) else [name for name, _ in topic]
        if any(name in self.broker.refused for name in wanted):
            return [NOT_AUTHORISED]
        for name in wanted:
            self._filters[name] = options
            for message in tuple(self.broker.retained.values()):
                if message.topic.matches(name):
                    self._deliver(message)
        return [qos] * len(wanted)

    async def publish(
        self, topic: str, payload: bytes | str = b"", *, qos: int = 0, retain: bool = False
    ) -> None:
        await self._respond()
        body = payload.encode() if isinstance(payload, str) else payload
        self.broker.publish(topic, body, qos=qos, retain=retain, sender=self)

    async def offer(self, topic: str, payload: bytes) -> bool:
        await self._respond()
        if topic in self.broker.unwanted:
            return False
        self.broker.publish(topic, payload, sender=self)
        return True

    @property
    async def messages(self) -> AsyncIterator[Message]:
        while True:
            yield await self._queue.get()

    async def lost(self) -> NoReturn:
        raise MqttError(await asyncio.shield(self._lost))

    def end_connection(self, reason: str) -> None:
        if not self._lost.done():
            self._lost.set_result(reason)

    def end(self, reason: str, *, taken_over: bool) -> None:
        """Lose the connection by the broker."""
        self.taken_over, self.closed_by_broker = taken_over, not taken_over
        self.end_connection(reason)
        self._leave()

    def hear(self, message: Message, sender: MemoryClient | None) -> None:
        found = [wish for name, wish in self._filters.items() if message.topic.matches(name)]
        wished = [wish for wish in found if not (wish and wish.noLocal and sender is self)]
        if not wished:
            return
        retain = bool(message.retain and wished[0] and wished[0].retainAsPublished)
        body = bytes(message.payload)
        self._deliver(Message(message.topic, body, message.qos, retain, 0, None))

    def _deliver(self, message: Message) -> None:
        if self.receive is not None:
            self.receive(message)
        else:
            self._queue.put_nowait(message)

    def _leave(self) -> None:
        if self in self.broker.clients:
            self.broker.clients.remove(self)
            if (will := self._will) is not None:
                body = bytes(will.payload)  # type: ignore[arg-type]
                self.broker.publish(will.topic, body, retain=will.retain)

    async def _respond(self) -> None:
        """Give other tasks their turn, and fail as a client does whose broker does not answer."""
        if self.broker.hangs:
            await self._answer(asyncio.Event().wait())
        await asyncio.sleep(0)
        if self not in self.broker.clients:
            raise MqttError("the client is not connected")

    async def _answer(self, waiting: Any) -> None:
        try:
            async with asyncio.timeout(self._timeout_s):
                await waiting
        except TimeoutError:
            pass
        raise MqttError("no answer from the broker")
