"""Drives that repeat what one real drive publishes: `replicas.py BROKER_PORT DRIVE COUNT`.

Each message of DRIVE is published again, with its topic and payload, under COUNT other names.
"""

from __future__ import annotations

import sys

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion


def main(port: int, drive: str, count: int) -> None:
    """Repeat for ever."""
    client = paho.Client(CallbackAPIVersion.VERSION2)

    def repeat(_: paho.Client, __: object, message: paho.MQTTMessage) -> None:
        tail = message.topic.split("/", 2)[2]
        retain = tail in {"state", "availability", "telemetry/load"}
        for number in range(count):
            topic = f"adaptdrive/replica{number}/{tail}"
            client.publish(topic, message.payload, qos=message.qos, retain=retain)

    client.on_message = repeat
    client.connect("127.0.0.1", port)
    client.subscribe([(f"adaptdrive/{drive}/#", 1)])
    client.loop_forever()


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]))
