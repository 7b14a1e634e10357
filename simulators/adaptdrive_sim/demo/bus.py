"""The bus and the ports of a demonstration, which it shares with no other one."""

from __future__ import annotations

import os
import socket
from contextlib import ExitStack
from dataclasses import dataclass

from adaptdrive_sim.device_settings import InterfaceChoice

VIRTUAL_INTERFACE = "vcan0"


@dataclass(frozen=True, slots=True)
class BusChoice:
    """A bus, in the words of the configuration.

    Attributes:
        interface: python-can interface.
        channel: Kernel interface or multicast group.
        udp_port: Port of `udp_multicast`.
    """

    interface: InterfaceChoice
    channel: str
    udp_port: int

    def __str__(self) -> str:
        port = f":{self.udp_port}" if self.interface == "udp_multicast" else ""
        return f"{self.interface} {self.channel}{port}"

    @property
    def section(self) -> dict[str, str | int]:
        """The keys of `[bus]` for this bus."""
        return {"interface": self.interface, "channel": self.channel, "udp_port": self.udp_port}


def choose_bus(interface: InterfaceChoice | None, channel: str | None, port: int) -> BusChoice:
    """Return the bus to use.

    Args:
        interface: The interface asked for; None for multicast on loopback.
        channel: The channel asked for; None for one of this process alone, or vcan0.
        port: Port for multicast.
    """
    if interface == "socketcan":
        return BusChoice(interface, channel or VIRTUAL_INTERFACE, port)
    number = os.getpid()
    group = f"239.74.{number >> 8 & 255}.{number & 255}"
    return BusChoice("udp_multicast", channel or group, port)


class Ports:
    """Free ports of the loopback interface, held until the demonstration ends.

    A held port is given to no other process that asks the kernel for any; who is told its number
    can listen at it.
    """

    def __init__(self) -> None:
        self._held = ExitStack()

    def take(self, kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
        """Return a free port."""
        probe = self._held.enter_context(socket.socket(socket.AF_INET, kind))
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])

    def close(self) -> None:
        """Give all back."""
        self._held.close()
