"""Commands without end: `flood.py BROKER_PORT RATE` sends set-points, each with its own id."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import time

if __name__ == "__main__":
    port, rate = sys.argv[1], float(sys.argv[2])
    topic = "adaptdrive/motor/command/setpoint"
    command = ["mosquitto_pub", "-p", port, "-t", topic, "-q", "1", "-l"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, text=True) as client:
        assert client.stdin is not None
        began_s = time.monotonic()
        for number in itertools.count():
            payload = {"id": f"flood-{began_s}-{number}", "value": 3.0 + 0.01 * (number % 20)}
            client.stdin.write(json.dumps(payload) + "\n")
            client.stdin.flush()
            time.sleep(max(0.0, began_s + number / rate - time.monotonic()))
