"""`[bus]` of a CiA 402 drive on CANopen: the node, its EDS, and the mutual supervision."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from adaptdrive.config.bus import BusSection, CanLink
from adaptdrive.config.section import FilePath, PositiveFloat, key


class CanOpenBus(CanLink, BusSection):
    """`[bus]` with `type = "canopen"`: a CiA 402 drive."""

    has_bridge_words: ClassVar[bool] = True
    """True: the controlword switches the bridge, the statusword confirms it."""

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
