"""Drives that only replay their frames: `player.py PORT,PORT... PRIORITY LOG`, until it is ended.

The drives' half cycles are spread evenly over the period. A half cycle that was played too late,
because the player itself was kept from running, is a line in LOG: no daemon is to blame for it.
"""

from __future__ import annotations

import socket
import sys
import time
from pathlib import Path

from tools.benchmarks.tools import GROUP, bus_socket, commanded_bridge, packed_frames, try_fifo

TICK_S = 1.0 / 120.0
LATE_S = 0.1 * TICK_S
LOOK_TICKS = 6
"""Half cycles between two looks at the commands: a bridge may take 30 to follow."""


def main(ports: list[int], priority: int, log: Path) -> None:
    """Play for ever."""
    played = [packed_frames(16 * 30, bridge=bridge) for bridge in (False, True)]
    bridges = [False] * len(ports)
    sockets = [bus_socket(port) for port in ports]
    for sock in sockets:
        sock.setblocking(False)
    try_fifo(priority)
    slot_s = TICK_S / len(ports)
    began_s, number = time.monotonic(), 0
    with log.open("w", encoding="utf-8", buffering=1) as late:
        while True:
            for i, (bus, port) in enumerate(zip(sockets, ports, strict=True)):
                status, load = played[bridges[i]][number % len(played[0])]
                late_s = _await(began_s + number * TICK_S + i * slot_s)
                bus.sendto(status, (GROUP, port))
                bus.sendto(load, (GROUP, port))
                if late_s > LATE_S:
                    late.write(f"{port} {late_s * 1e3:.2f} ms\n")
                if number % LOOK_TICKS == 0:
                    bridges[i] = _follow(bus, bridges[i])
            number += 1


def _follow(bus: socket.socket, bridge: bool) -> bool:
    """Read what has come; return the bridge of the last command in it, or as it was."""
    while True:
        try:
            commanded = commanded_bridge(bus.recv(512))
        except BlockingIOError:
            return bridge
        bridge = bridge if commanded is None else commanded


def _await(deadline_s: float) -> float:
    """Wait for a time; how much later it is now."""
    rest_s = deadline_s - time.monotonic()
    if rest_s > 0.0:
        time.sleep(rest_s)
    return time.monotonic() - deadline_s


if __name__ == "__main__":
    main([int(word) for word in sys.argv[1].split(",")], int(sys.argv[2]), Path(sys.argv[3]))
