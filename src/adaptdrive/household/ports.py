"""Free ports of the loopback interface, and what listens there."""

from __future__ import annotations

import socket
from contextlib import ExitStack, suppress

HOST = "127.0.0.1"


class Ports:
    """Free ports of the loopback interface, held until they are given back.

    A held port is given to no other process that asks the kernel for any; who is told its number
    can listen at it.
    """

    def __init__(self) -> None:
        self._held = ExitStack()

    def take(self, kind: socket.SocketKind = socket.SOCK_STREAM, usual: int = 0) -> int:
        """Return a free port.

        Args:
            kind: Of TCP or UDP.
            usual: The port to take where it is free and no other program is taking it; any when 0.
        """
        usual = usual if usual and self._reserve(usual) else 0
        probe = self._held.enter_context(socket.socket(socket.AF_INET, kind))
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, usual))
        except OSError:
            probe.bind((HOST, 0))
        return int(probe.getsockname()[1])

    def _reserve(self, port: int) -> bool:
        """Return whether no other program holds this number, although nothing listens there yet."""
        mark = self._held.enter_context(socket.socket(socket.AF_UNIX))
        try:
            mark.bind(f"\0adaptdrive-port-{port}")
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Give all back."""
        self._held.close()


def is_listening(host: str, port: int, wait_s: float = 1.0) -> bool:
    """Return whether something takes connections at a TCP port.

    Args:
        host: Name or address.
        port: The port.
        wait_s: Longest wait.
    """
    with suppress(OSError):
        socket.create_connection((host, port), wait_s).close()
        return True
    return False
