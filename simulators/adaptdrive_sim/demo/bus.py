"""The bus of a demonstration: the one asked for, else the best that this machine has."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.config.bus import CanBus
from adaptdrive.errors import BusError
from adaptdrive.hardware.link.bus import open_bus
from adaptdrive_sim.device_settings import InterfaceChoice

VIRTUAL_INTERFACE = "vcan0"
GROUP = "239.74.163.2"


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


def choose_bus(interface: InterfaceChoice | None, channel: str | None) -> BusChoice:
    """The bus to use.

    Args:
        interface: The interface asked for; None for the best one: the kernel's virtual CAN where
            there is one, else multicast on loopback.
        channel: The channel asked for; None for the interface's usual one.
    """
    # A port of its own keeps two demonstrations on one machine apart.
    port = free_port(socket.SOCK_DGRAM)
    if interface is None:
        kernel = BusChoice("socketcan", VIRTUAL_INTERFACE, port)
        return kernel if _usable(kernel) else BusChoice("udp_multicast", GROUP, port)
    usual = VIRTUAL_INTERFACE if interface == "socketcan" else GROUP
    return BusChoice(interface, channel or usual, port)


def free_port(kind: socket.SocketKind) -> int:
    """Return a port of the loopback interface that was free at the call."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _usable(bus: BusChoice) -> bool:
    unread = Path("adaptdrive.dbc")
    config = CanBus(
        type="can",
        interface=bus.interface,
        channel=bus.channel,
        database=unread,
        clock="DriveLoad",
    )
    try:
        open_bus(config).shutdown()
    except BusError:
        return False
    return True
