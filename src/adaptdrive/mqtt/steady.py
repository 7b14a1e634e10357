"""aiomqtt's client, made fit to live in the event loop of a controller."""

import asyncio
import math
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, NoReturn, TypeVar

import paho.mqtt.client as paho
from aiomqtt import Client, Message, MqttCodeError, MqttError, ProtocolVersion
from aiomqtt.types import PahoSocket
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode

from adaptdrive.util.lines import write_line

T = TypeVar("T")

_HEADER_BYTES = 10
"""Most that a PUBLISH packet adds to its topic and its payload: lengths, packet id, properties."""

# Reason codes of MQTT 5; paho gives the second where the broker gave none.
_TAKEN_OVER = 142
_UNSPECIFIED = 128


def _read_every_refusal() -> None:
    """Have paho read each failure code of MQTT 5 as the answer to a message.

    It ends the connection at one that the standard keeps for other packets. mosquitto gives such a
    code, *packet too large*, for a message above its `message_size_limit`.
    """
    for code, names in ReasonCode.names.items():
        packets = next(iter(names.values()))
        if code >= _UNSPECIFIED and PacketTypes.PUBACK not in packets:
            packets.append(PacketTypes.PUBACK)


_read_every_refusal()


class SteadyClient(Client):
    """A client that leaves nothing behind in the event loop.

    What it overrides and calls is private to aiomqtt 2.

    Attributes:
        protocol: Version of MQTT.
        receive: Takes each message as it arrives, ahead of every queue and task; None for a queue.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401 - aiomqtt's signature
        super().__init__(*args, **kwargs)
        self.protocol = kwargs.get("protocol", ProtocolVersion.V311)
        self._client.connect_timeout = self.timeout  # of TCP, and of the handshake of TLS
        self.receive: Callable[[Message], None] | None = None
        self._largest: int | None = None
        self._withheld: set[str] = set()
        self._refusals: set[int] = set()
        self._offers: dict[int, asyncio.Future[bool]] = {}

    async def publish(  # type: ignore[override]
        self,
        /,
        topic: str,
        payload: bytes | str = b"",
        *args: Any,  # noqa: ANN401 - aiomqtt's signature
        **kwargs: Any,  # noqa: ANN401
    ) -> None:
        """Publish a message, unless it is larger than the broker says it takes.

        A broker ends the connection of a client that sends more, and no `disable` would arrive.
        """
        size = _HEADER_BYTES + len(topic.encode()) + len(payload)
        if self._largest is None or size <= self._largest:
            await super().publish(topic, payload, *args, **kwargs)
        elif topic not in self._withheld:
            self._withheld.add(topic)
            write_line(
                "error",
                "message withheld: the broker takes no packet of this size",
                topic=topic,
                bytes=size,
                largest=self._largest,
            )

    async def offer(self, topic: str, payload: bytes) -> bool:
        """Publish a message that may be refused; return whether the broker takes it.

        A broker of MQTT 3.1.1 does not say that it refuses a message.

        Raises:
            MqttError: The broker does not answer.
        """
        number = self._client.publish(topic, payload, qos=1).mid
        self._offers[number] = answer = self._loop.create_future()
        try:
            return await self._wait_for(answer, None)
        finally:
            del self._offers[number]

    @property
    def taken_over(self) -> bool:
        """True if the broker ended the connection for another client of the same name."""
        return self._end_code == _TAKEN_OVER

    @property
    def closed_by_broker(self) -> bool:
        """True if the broker closed the connection without a reason."""
        return self._end_code in (paho.MQTT_ERR_CONN_LOST, _UNSPECIFIED)

    @property
    def _end_code(self) -> object:
        ended = self._disconnected.done() and not self._disconnected.cancelled()
        problem = self._disconnected.exception() if ended else None
        return problem.rc if isinstance(problem, MqttCodeError) else None

    def cancel_connecting(self) -> None:
        """End the wait for the broker's answer to a connection that is being made."""
        if not self._connected.done():
            self._connected.set_exception(MqttError("given up"))
            self._connected.exception()  # retrieved, where nobody waits for it yet

    def end_connection(self, reason: str) -> None:
        """End the connection; `lost` raises the reason."""
        if not self._disconnected.done():
            self._disconnected.set_exception(MqttError(reason))

    async def lost(self) -> NoReturn:
        """Wait until the connection ends.

        Raises:
            MqttError: It has ended, and why.
        """
        await asyncio.wait([self._disconnected])
        problem = self._disconnected.exception()
        raise MqttError(str(problem or "the broker closed the connection")) from problem

    def _on_connect(self, *args: Any) -> None:  # noqa: ANN401 - aiomqtt's signature
        self._largest = getattr(args[-1], "MaximumPacketSize", None)
        super()._on_connect(*args)

    def _on_subscribe(self, client: paho.Client, userdata: object, mid: int, *args: Any) -> None:  # noqa: ANN401 - aiomqtt's signature
        """Take the answer to a subscription that is still awaited.

        aiomqtt writes one that comes after the end of the wait with a traceback.
        """
        if mid in self._pending_subscribes:
            super()._on_subscribe(client, userdata, mid, *args)

    def _on_message(self, client: paho.Client, userdata: object, message: paho.MQTTMessage) -> None:
        if self.receive is None:
            super()._on_message(client, userdata, message)
        else:
            self.receive(Message._from_paho_message(message))  # noqa: SLF001
        self._acknowledge_segment()

    def _on_publish(self, *args: Any) -> None:  # noqa: ANN401 - aiomqtt's signature
        super()._on_publish(*args)
        offer = self._offers.get(args[2])
        if offer is None:
            self._write_refusal(args[3])
        elif not offer.done():
            offer.set_result(not args[3].is_failure)
        self._acknowledge_segment()

    def _write_refusal(self, code: ReasonCode) -> None:
        """Write once for each connection and reason that a message is delivered to nobody."""
        if code.is_failure and code.value not in self._refusals:
            self._refusals.add(code.value)
            write_line(
                "error",
                "the broker refuses to deliver messages of this daemon: events, replies or its "
                "state are lost; see the access list of the broker and its limit of their size",
                code=str(code),
            )

    def _acknowledge_segment(self) -> None:
        """Acknowledge received data to TCP at once, not within 40 ms.

        A broker with Nagle's algorithm holds back the next command until then.
        """
        connection = self._client.socket()
        if isinstance(connection, socket.socket):
            with suppress(OSError):
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)

    async def release(self) -> None:
        """Close the socket of a client that was never connected, or whose broker hangs.

        aiomqtt leaves such a socket, its reader and a task behind until the
        keep-alive ends; the client under it can close them at once.
        """
        self._client.reinitialise()
        if self._disconnected.done() and not self._disconnected.cancelled():
            self._disconnected.exception()  # retrieved, where nobody waits for it any more
        if self._misc_task is not None:
            self._misc_task.cancel()
            await asyncio.wait([self._misc_task])

    async def _wait_for(self, fut: Awaitable[T], timeout: float | None) -> T:  # noqa: ASYNC109
        """Wait without ever losing a cancellation, as `asyncio.wait_for` does before 3.12."""
        limit_s = self.timeout if timeout is None else timeout
        try:
            async with asyncio.timeout(None if limit_s == math.inf else limit_s):
                return await fut
        except TimeoutError:
            raise MqttError("no answer from the broker") from None

    def _on_socket_register_write(
        self,
        client: paho.Client,
        userdata: object,  # noqa: ARG002 - paho's signature
        sock: PahoSocket,
    ) -> None:
        """Watch the socket for writing, unless it was closed meanwhile.

        aiomqtt passes the number of the socket on, to be used one round of the loop later: by
        then the number may be that of a bus, whose frames would not be read any more.
        """

        def write() -> None:
            try:
                client.loop_write()
            except Exception as problem:  # noqa: BLE001 - passed to the task that awaits the client
                if not self._disconnected.done():
                    self._disconnected.set_exception(problem)

        def watch() -> None:
            if sock.fileno() >= 0:
                self._loop.add_writer(sock.fileno(), write)

        try:
            asyncio.get_running_loop()
        except RuntimeError:  # a connection is opened in another thread
            self._loop.call_soon_threadsafe(watch)
        else:
            watch()
