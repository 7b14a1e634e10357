"""A drive on a real broker that answers commands as a daemon does, and may keep an answer back."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from typing import Any

from adaptdrive.mqtt.steady import SteadyClient
from tests.support import Broker

PERIOD_S = 0.05


class AnsweringDrive:
    """A drive that does at once what it is asked for.

    Attributes:
        name: Name.
        verbs: Commands that came, without the repeated ones.
        mode: Mode.
        state: State, of which the coasting is a part.
        stopped: Set when a `disable` came.
        answers_stop: Lets the answer to it go.
    """

    def __init__(self, client: SteadyClient, name: str) -> None:
        self.verbs: list[str] = []
        self.mode, self.state, self.coasting = "fixed", "standby", False
        self.stopped, self.answers_stop = asyncio.Event(), asyncio.Event()
        self.name = name
        self._client, self._place = client, f"adaptdrive/{name}"

    async def run(self) -> None:
        """Publish telemetry, and answer, until cancelled."""
        await self._client.subscribe(f"{self._place}/command/+", qos=1)
        await self._client.publish(f"{self._place}/availability", "online", retain=True)
        await self.show()
        async with asyncio.TaskGroup() as group:
            group.create_task(self._publish_telemetry())
            async for message in self._client.messages:
                verb = message.topic.value.rpartition("/")[2]
                group.create_task(self._answer(verb, json.loads(bytes(message.payload))))

    async def show(self) -> None:
        """Publish the state."""
        state = {"state": self.state, "mode": self.mode, "coasting": self.coasting}
        await self._client.publish(f"{self._place}/state", json.dumps(state), qos=1, retain=True)

    async def _publish_telemetry(self) -> None:
        while True:
            message = {
                "time": datetime.now(UTC).isoformat(),
                "age_s": 0.0,
                "boost_voltage_V": 200.0,
                "output": 1.0,
                "command": {"bridge": self.state == "running" and not self.coasting},
            }
            await self._client.publish(f"{self._place}/telemetry/drive", json.dumps(message))
            await asyncio.sleep(PERIOD_S)

    async def _answer(self, verb: str, command: dict[str, Any]) -> None:
        if verb not in self.verbs[-1:]:
            self.verbs.append(verb)
        if verb == "mode":
            self.mode = command["value"]
        elif verb == "enable":
            self.state, self.coasting = "running", True
        elif verb == "voltage":
            self.coasting = False
        elif verb == "disable":
            self.state, self.coasting = "standby", False
            self.stopped.set()
            await self.answers_stop.wait()
        await self.show()
        reply = {"id": command["id"], "verb": verb, "accepted": True, "reason": "", "state": None}
        await self._client.publish(f"{self._place}/reply", json.dumps(reply), qos=1)


@asynccontextmanager
async def answering_drive(broker: Broker, name: str) -> AsyncIterator[AnsweringDrive]:
    """Keep such a drive on a broker."""
    async with SteadyClient(broker.host, broker.port) as client:
        drive = AnsweringDrive(client, name)
        running = asyncio.create_task(drive.run())
        try:
            yield drive
        finally:
            running.cancel()
            await asyncio.wait([running])
