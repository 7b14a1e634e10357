"""aiomqtt's client, made fit to live in the event loop of a controller."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable
from typing import TypeVar

import paho.mqtt.client as paho
from aiomqtt import Client, MqttError
from aiomqtt.types import PahoSocket

from adaptdrive.operation.waiting import NewestMessages

T = TypeVar("T")


class SteadyClient(Client):
    """A client that leaves nothing behind in the event loop.

    What it overrides and calls is private to aiomqtt 2.
    """

    @property
    def dropped(self) -> int:
        """Messages that nobody read in time, and that newer ones have pushed out."""
        return self._queue.dropped if isinstance(self._queue, NewestMessages) else 0

    async def release(self) -> None:
        """Close the socket of a client that was never connected, or whose broker hangs.

        aiomqtt leaves such a socket, its reader and a task of its own behind until the
        keep-alive ends; the client under it can close them at once.
        """
        self._client.reinitialise()
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
            except Exception as problem:  # noqa: BLE001 - handed on to whoever awaits the client
                if not self._disconnected.done():
                    self._disconnected.set_exception(problem)

        def watch() -> None:
            if sock.fileno() >= 0:
                self._loop.add_writer(sock.fileno(), write)

        self._loop.call_soon_threadsafe(watch)
