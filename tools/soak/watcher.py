"""A client that hears what a page of the panel hears, and an operator who uses it.

It is on the broker's listener for browsers, with a user, and subscribes as the panel does.
"""

from __future__ import annotations

import json
import random
import threading
import time
from collections import Counter
from typing import Any, Self

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from tests.system.access.broker import password

USER = "operator"
PATIENCE_s = 60.0


class Watcher:
    """One panel that stays open.

    Attributes:
        heard: Messages by topic.
        events: Tick, kind and text of the events heard.
        replies: Replies by id.
    """

    def __init__(self, port: int, seed: int) -> None:
        """Connect nothing yet.

        Args:
            port: Of the listener for browsers.
            seed: Of what the operator does.
        """
        self.heard: Counter[str] = Counter()
        self.events: set[tuple[int, str, str]] = set()
        self.replies: dict[str, dict[str, Any]] = {}
        self.state: dict[str, Any] = {}
        self._draw = random.Random(seed)
        self._number = 0
        self._subscribed = threading.Event()
        self._client = paho.Client(CallbackAPIVersion.VERSION2, transport="websockets")
        self._client.username_pw_set(USER, password(USER))
        self._client.on_message = self._take
        self._client.on_connect = lambda client, *_: client.subscribe("adaptdrive/#", 1)
        self._client.on_subscribe = lambda *_: self._subscribed.set()
        self._port = port

    def __enter__(self) -> Self:
        self._client.connect("127.0.0.1", self._port)
        self._client.loop_start()
        if not self._subscribed.wait(PATIENCE_s):
            raise RuntimeError("the panel's listener takes no subscription")
        return self

    def __exit__(self, *_: object) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def ask(self, verb: str, value: object = None) -> dict[str, Any]:
        """Send a command and return the reply to it.

        Raises:
            RuntimeError: There is none.
        """
        self._number += 1
        identity = f"soak-{self._number}"
        payload = json.dumps({"id": identity, "value": value})
        self._client.publish(f"adaptdrive/motor/command/{verb}", payload, qos=1)
        deadline_s = time.monotonic() + PATIENCE_s
        while identity not in self.replies:
            if time.monotonic() > deadline_s:
                raise RuntimeError(f"no reply to {verb}")
            time.sleep(0.02)
        return self.replies[identity]

    def operate(self) -> None:
        """Do one thing that operators do; a drive that does not run is brought up."""
        if self.state.get("state") not in {"running", "starting"}:
            self.ask("reset")
            self.ask("enable")
            return
        act = self._draw.choices(("setpoint", "mode", "disable"), (88, 10, 2))[0]
        reach = self.state.get("reach") or {"low": 2.5, "high": 4.0}
        span = reach["high"] - reach["low"]
        values: dict[str, object] = {
            "setpoint": round(reach["low"] + self._draw.uniform(0.1, 0.8) * span, 3),
            "mode": self._draw.choice(("adaptive", "adaptive", "fixed")),
        }
        self.ask(act, values.get(act))

    def _take(self, _client: object, _data: object, message: paho.MQTTMessage) -> None:
        topic = message.topic.removeprefix("adaptdrive/motor/")
        self.heard[topic] += 1
        if topic not in {"event", "reply", "state"} or not message.payload:
            return
        content = json.loads(message.payload)
        if topic == "event":
            self.events.add((content["tick"], content["kind"], content["detail"]))
        elif topic == "reply":
            self.replies[content["id"]] = content
        else:
            self.state = content
