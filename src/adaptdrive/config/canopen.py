"""`[bus]` of a CiA 402 drive on CANopen: the node, its EDS, and the mutual supervision."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from adaptdrive.config.bus import BusSection, CanLink, Signals
from adaptdrive.config.section import FilePath, PositiveFloat, key
from adaptdrive.errors import Flaw

_LATE_HEARTBEATS = 2.0
"""Heartbeats that must fit into a time-out: one may go missing."""


class CanOpenBus(CanLink, BusSection):
    """`[bus]` with `type = "canopen"`: a CiA 402 drive."""

    type: Literal["canopen"]
    eds: FilePath
    node_id: int = Field(ge=1, le=127)
    own_node_id: int = key(127, span=(1, 127))
    sync: Literal["drive", "daemon"] = "daemon"
    heartbeat_s: PositiveFloat = key(0.02, span=(0.005, 1.0))
    heartbeat_timeout_s: PositiveFloat = key(0.1, le=2.0)
    sdo_timeout_s: PositiveFloat = key(0.3, span=(0.01, 10.0))

    @property
    def command_timeout_s(self) -> float:
        """Time after a command for which the drive does not miss the heartbeat.

        The heartbeat before that command may be the last one: not each command has one.
        """
        return self.heartbeat_timeout_s - self.heartbeat_s

    @property
    def drive_clocks(self) -> bool:
        """True when the drive sends SYNC."""
        return self.sync == "drive"

    @property
    def has_bridge_words(self) -> bool:
        """True: the controlword switches the bridge, the statusword confirms it."""
        return True


def canopen_flaws(bus: CanOpenBus, signals: Signals) -> Iterator[Flaw]:
    """Yield the contradictions to the profile that need no EDS to detect.

    Args:
        bus: `[bus]`.
        signals: `[signals]`.
    """
    if bus.own_node_id == bus.node_id:
        yield Flaw("bus.own_node_id", f"{bus.own_node_id} is the drive's own node id")
    if bus.heartbeat_timeout_s < _LATE_HEARTBEATS * bus.heartbeat_s:
        lowest = f"{_LATE_HEARTBEATS:g} times bus.heartbeat_s = {bus.heartbeat_s}"
        yield Flaw(
            "bus.heartbeat_timeout_s", f"{bus.heartbeat_timeout_s} must be at least {lowest}"
        )
    if signals.bridge is not None:
        yield Flaw("signals.bridge", "the statusword 0x6041 contains it: leave it out")
    if signals.command.bridge is not None:
        yield Flaw("signals.command.bridge", "the controlword 0x6040 carries it: leave it out")
    if signals.counter is not None and bus.sync == "daemon":
        yield Flaw(
            "signals.counter", "bus.sync = 'daemon' makes the daemon the clock: leave it out"
        )
