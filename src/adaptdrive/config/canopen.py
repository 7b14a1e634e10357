"""`[bus]` of a CiA 402 drive on CANopen: the node, its EDS, and the mutual supervision."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from adaptdrive.config.bus import BusSection, CanLink, Signals
from adaptdrive.config.section import FilePath, PositiveFloat
from adaptdrive.errors import Flaw

_LATE_HEARTBEATS = 2.0
"""Heartbeats that must fit into a time-out: one may go missing."""


class CanOpenBus(CanLink, BusSection):
    """`[bus]` with `type = "canopen"`: a CiA 402 drive."""

    type: Literal["canopen"] = Field(description="kind of bus")
    eds: FilePath = Field(
        description="electronic data sheet of the drive, relative to the configuration file"
    )
    node_id: int = Field(ge=1, le=127, description="node id of the drive")
    own_node_id: int = Field(
        default=127,
        ge=1,
        le=127,
        description="node id of the daemon, for its heartbeat; no other node may have it",
    )
    sync: Literal["drive", "daemon"] = Field(
        default="daemon",
        description="sender of SYNC each half line cycle; the drive sends it at a fixed line phase",
    )
    heartbeat_s: PositiveFloat = Field(
        default=0.02,
        ge=0.005,
        le=1.0,
        description="time between two heartbeats, of the drive and of the daemon",
    )
    heartbeat_timeout_s: PositiveFloat = Field(
        default=0.1,
        le=2.0,
        description="silence after which the drive makes itself safe, and the daemon trips",
    )
    sdo_timeout_s: PositiveFloat = Field(
        default=0.3, ge=0.01, le=10.0, description="longest time from an SDO request to its reply"
    )

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
