"""Notices that the broker delivers no commands: a message of the daemon's own must come back.

mosquitto accepts a subscription to topics which its access list does not let the daemon read, and
delivers nothing. No answer shows that, and a drive would run on whatever an operator asks for.
"""

from __future__ import annotations

import asyncio
import secrets
from contextlib import suppress

from aiomqtt import Message

from adaptdrive.operation.intake import Intake
from adaptdrive.operation.steady import SteadyClient
from adaptdrive.runtime.reports import Severity

PROBE_EVERY_S = 60.0
PATIENCE_S = 10.0
"""Longest way of a message to the broker and back."""


class CommandProbe:
    """Sends a message to a topic among the commands, again and again, and awaits it.

    A broker that does not take it, as one with an older access list, shows nothing.
    """

    def __init__(self, client: SteadyClient, topic: str, intake: Intake) -> None:
        """Send nothing yet.

        Args:
            client: Connected by MQTT 5; a broker of MQTT 3.1.1 does not answer whether it takes a
                message.
            topic: Subscribed to in addition to the commands, with the daemon's own messages.
            intake: Takes the alarm, and its end.
        """
        self._client = client
        self._topic = topic
        self._intake = intake
        self._token = secrets.token_hex(8).encode()
        self._arrived = asyncio.Event()
        self._deaf = False

    def takes(self, message: Message) -> bool:
        """Return whether a message is the probe's own."""
        own = message.topic.value == self._topic and message.payload == self._token
        if own:
            self._arrived.set()
        return own

    async def send(self) -> None:
        """Look once whether commands arrive.

        Raises:
            MqttError: The connection is lost.
        """
        self._arrived.clear()
        if await self._client.offer(self._topic, self._token):
            self._report(deaf=not await self._arrives())

    async def _arrives(self) -> bool:
        with suppress(TimeoutError):
            async with asyncio.timeout(PATIENCE_S):
                await self._arrived.wait()
        return self._arrived.is_set()

    def _report(self, *, deaf: bool) -> None:
        if deaf == self._deaf:
            return
        self._deaf = deaf
        if deaf:
            self._intake.report_deaf(
                f"the broker has taken a message to {self._topic} and does not deliver it to this "
                f"daemon within {PATIENCE_S:g} s"
            )
        else:
            self._intake.report("broker", Severity.INFO, "commands arrive again")
