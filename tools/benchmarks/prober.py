"""A drive that only replays frames, and times the answers.

`prober.py SECONDS PORT[,ECHO_PORT...]` sends a half cycle's frames every 1/120 s to the daemon on
the first port, and the same to each echo a little later. Prints the times from the last frame
to the answer, in microseconds; -1 where none came within 6 ms.
"""

from __future__ import annotations

import json
import os
import select
import socket
import sys
import time

from tools.benchmarks.tools import (
    GROUP,
    PRIORITY,
    bus_socket,
    commanded_bridge,
    is_command,
    packed_frames,
    try_fifo,
)

TICK_S = 1.0 / 120.0
SETTLE_S = 4.5
"""Answers before this time do not count: the drive is being started, and at 4 s the counter of the
replayed frames begins anew, which the daemon first takes for a restart of the drive."""

_FRAME_S = 250e-6
_PATIENCE_S = 6e-3
_ECHO_PATIENCE_S = 1e-3


def main(duration_s: float, ports: list[int]) -> dict[str, list[float]]:
    """Probe for so long."""
    played = [packed_frames(16 * 30, bridge=bridge) for bridge in (False, True)]
    sockets = [bus_socket(port) for port in ports]
    try_fifo(PRIORITY + 10)
    found: dict[str, list[float]] = {str(port): [] for port in ports}
    began_s, bridge = time.monotonic(), False
    for number in range(round(duration_s / TICK_S)):
        _sleep_until(began_s + number * TICK_S)
        status, load = played[bridge][number % len(played[bridge])]
        for bus, port in zip(sockets, ports, strict=True):
            patience_s = _PATIENCE_S if port == ports[0] else _ECHO_PATIENCE_S
            bus.sendto(status, (GROUP, port))
            time.sleep(_FRAME_S)
            _drain(bus)
            time_us, answer = _probe(bus, port, load, patience_s)
            if port == ports[0] and answer:
                bridge = bool(commanded_bridge(answer))
            if number * TICK_S >= SETTLE_S:
                found[str(port)].append(time_us)
    return found


def _sleep_until(deadline_s: float) -> None:
    rest_s = deadline_s - time.monotonic()
    if rest_s > 0.0:
        time.sleep(rest_s)


def _drain(bus: socket.socket) -> None:
    while True:
        try:
            bus.recv(512, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return


def _probe(
    bus: socket.socket, port: int, datagram: bytes, patience_s: float
) -> tuple[float, bytes]:
    """Send a frame; return the time to the answer in microseconds, and the answer."""
    began_s = time.monotonic()
    bus.sendto(datagram, (GROUP, port))
    while (rest_s := began_s + patience_s - time.monotonic()) > 0.0:
        if not select.select([bus], [], [], rest_s)[0]:
            break
        answer = bus.recv(512)
        now_s = time.monotonic()
        if answer[0] == 69 or (answer != datagram and is_command(answer)):
            return (now_s - began_s) * 1e6, answer
    return -1.0, b""


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    result = main(float(sys.argv[1]), [int(word) for word in sys.argv[2].split(",")])
    sys.stdout.write(json.dumps(result))
