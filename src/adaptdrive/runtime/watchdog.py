"""The service manager: ready, status, and the watchdog that the fast loop feeds."""

from __future__ import annotations

import socket
from collections.abc import Mapping


class ServiceManager:
    """Sends messages of the sd_notify protocol; does nothing without a service manager."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        """Connect to the manager that the environment names.

        Args:
            environment: Process environment, with NOTIFY_SOCKET and WATCHDOG_USEC or without.
        """
        self._socket: socket.socket | None = None
        address = environment.get("NOTIFY_SOCKET", "")
        if address:
            if address.startswith("@"):
                address = "\0" + address[1:]
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.settimeout(0.0)
            self._address = address
        watchdog_us = environment.get("WATCHDOG_USEC", "")
        self._feed_every_s = int(watchdog_us) * 1e-6 / 4.0 if watchdog_us.isdigit() else 0.0
        self._unsent: dict[str, str] = {}
        self._fed_s = float("-inf")
        self._status = ""

    def ready(self) -> None:
        """Configuration, bus and loop are up."""
        self._notify("READY=1")

    def status(self, text: str) -> None:
        """Send the status in one line, if it has changed."""
        if text != self._status:
            self._status = text
            self._notify(f"STATUS={text}")

    def stopping(self) -> None:
        """An orderly stop has begun."""
        self._notify("STOPPING=1")

    def feed(self, now_s: float) -> None:
        """Report a tick that met its deadline, four times per watchdog period."""
        if self._unsent:
            self._deliver()
        if self._feed_every_s and now_s - self._fed_s >= self._feed_every_s:
            self._fed_s = now_s
            self._notify("WATCHDOG=1")

    def close(self) -> None:
        """Stop speaking."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _notify(self, message: str) -> None:
        """Send a message after those that wait; a newer one of its kind takes its place there."""
        if self._socket is not None:
            self._unsent[message.partition("=")[0]] = message
            self._deliver()

    def _deliver(self) -> None:
        """Send what waits as far as the manager has room; nothing waits for one that is gone."""
        while self._socket is not None and self._unsent:
            kind, message = next(iter(self._unsent.items()))
            try:
                self._socket.sendto(message.encode(), self._address)
            except BlockingIOError:
                return
            except OSError:
                pass
            del self._unsent[kind]
