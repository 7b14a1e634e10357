"""The embedded broker as a process: `… broker_main HOST:PORT [WEBSOCKET_HOST:PORT]`.

It implements MQTT 3.1.1, keeps nothing on disk and needs no password: for demonstrations and desks.
"""

import asyncio
import logging
import signal
import sys

from amqtt.broker import Broker
from amqtt.session import Session

_ANYBODY = "amqtt.plugins.authentication.AnonymousAuthPlugin"


class EmbeddedBroker(Broker):  # type: ignore[misc]  # amqtt is untyped
    """amqtt, without the retained messages that it sends to clients which never asked for them.

    To every client that connects, amqtt 0.12 sends what is retained on any topic that any client
    has subscribed to.
    """

    async def _publish_retained_messages_for_subscription(
        self, subscription: tuple[str, int], session: Session
    ) -> None:
        subscribers = self._subscriptions.get(subscription[0], [])
        if any(subscriber.client_id == session.client_id for subscriber, _ in subscribers):
            await super()._publish_retained_messages_for_subscription(subscription, session)


async def serve(address: str, websocket: str | None = None) -> None:
    """Serve until SIGTERM or SIGINT.

    Args:
        address: HOST:PORT to listen at.
        websocket: HOST:PORT of the listener for web pages, None for none.
    """
    listeners = {"default": {"type": "tcp", "bind": address}}
    if websocket is not None:
        listeners["page"] = {"type": "ws", "bind": websocket}
    asked = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, asked.set)
    broker = EmbeddedBroker(
        {
            "listeners": listeners,
            "plugins": {_ANYBODY: {"allow_anonymous": True}},
        }
    )
    await broker.start()
    await asked.wait()
    await broker.shutdown()


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING)
    asyncio.run(serve(*sys.argv[1:]))
