"""The bus of a demonstration, which it shares with no other one."""

from __future__ import annotations

import os
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
