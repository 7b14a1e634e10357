"""A client that publishes on the topics of a drive, and never has more than some unanswered.

A ping among the messages, whose answer is awaited, shows that what was sent before it was taken.
"""

from __future__ import annotations

import json
import threading
import time
from typing import Any

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion

DRIVE = "adaptdrive/motor"
AT_ONCE = 50
"""Half of what a daemon keeps of commands that wait."""

PATIENCE_S = 120.0


class Fence:
    """Publishes, and waits for the answers.

    Attributes:
        replies: All answers but those to its own pings.
        state: The newest state of the drive.
    """

    def __init__(self, port: int) -> None:
        self.replies: list[dict[str, Any]] = []
        self.state: dict[str, Any] = {}
        self._sent = self._asked = 0
        self._passed: set[str] = set()
        self._retained: set[str] = set()
        self._news = threading.Condition()
        self._client = paho.Client(CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
        self._client.on_message = self._hear
        self._client.connect("127.0.0.1", port)
        self._client.subscribe([(f"{DRIVE}/reply", 1), (f"{DRIVE}/state", 1)])
        self._client.loop_start()
        self.wait()

    def send(self, name: str, raw: bytes, *, retain: bool, answered: bool) -> None:
        """Publish on a topic of the drive; wait for the answers of some at once."""
        if retain:
            self._retained.add(name)
        self._client.publish(f"{DRIVE}/{name}", raw, qos=1, retain=retain)
        self._asked += answered
        self._sent += 1
        if self._sent % AT_ONCE == 0:
            self.wait()

    def wait(self) -> None:
        """Wait until all that was sent has been answered."""
        mark = f"fence-{time.monotonic_ns()}"
        self._client.publish(f"{DRIVE}/command/ping", json.dumps({"id": mark}), qos=1)
        with self._news:
            done = self._news.wait_for(
                lambda: mark in self._passed and len(self.replies) >= self._asked, PATIENCE_S
            )
        if not done:
            raise AssertionError(f"{len(self.replies)} answers to {self._asked} payloads")
        self._passed.clear()

    def forget_retained(self) -> None:
        """Have the broker forget what was retained, which is a payload like any other."""
        for name in self._retained:
            self.send(name, b"", retain=True, answered=name.startswith("command/"))
        self.wait()

    def close(self) -> None:
        """End the connection."""
        self._client.disconnect()
        self._client.loop_stop()

    def _hear(self, _: paho.Client, __: object, message: paho.MQTTMessage) -> None:
        content = json.loads(message.payload)
        with self._news:
            if message.topic.endswith("/state"):
                self.state = content
            elif str(content["id"]).startswith("fence-"):
                self._passed.add(content["id"])
            else:
                self.replies.append(content)
            self._news.notify()
