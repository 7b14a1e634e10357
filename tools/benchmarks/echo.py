"""A bare echo on the bus in Python: `echo.py PORT`. Answers what is not an answer itself."""

from __future__ import annotations

import sys

from tools.benchmarks.tools import ECHO, GROUP, PRIORITY, bus_socket, try_fifo

if __name__ == "__main__":
    port = int(sys.argv[1])
    bus = bus_socket(port)
    try_fifo(PRIORITY)
    while True:
        data = bus.recv(512)
        if not data.startswith(ECHO):
            bus.sendto(ECHO + data, (GROUP, port))
