"""Drives that only replay their frames: `player.py PORT,PORT... PRIORITY`, until it is ended.

The drives' half cycles are spread evenly over the period.
"""

from __future__ import annotations

import sys
import time

from tests.benchmarks.tools import GROUP, bus_socket, packed_frames, try_fifo

TICK_S = 1.0 / 120.0


def main(ports: list[int], priority: int) -> None:
    """Play for ever."""
    frames = packed_frames(16 * 30)
    sockets = [bus_socket(port) for port in ports]
    for sock in sockets:
        sock.setblocking(False)
    try_fifo(priority)
    slot_s = TICK_S / len(ports)
    began_s, number = time.monotonic(), 0
    while True:
        status, load = frames[number % len(frames)]
        for i, (bus, port) in enumerate(zip(sockets, ports, strict=True)):
            rest_s = began_s + number * TICK_S + i * slot_s - time.monotonic()
            if rest_s > 0.0:
                time.sleep(rest_s)
            bus.sendto(status, (GROUP, port))
            bus.sendto(load, (GROUP, port))
        number += 1


if __name__ == "__main__":
    main([int(word) for word in sys.argv[1].split(",")], int(sys.argv[2]))
