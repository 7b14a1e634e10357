"""Frames that command the drive: those of this port, and those of another sender."""

from __future__ import annotations

from collections.abc import Iterator

import can

from adaptdrive.config.canopen import CanOpenBus
from adaptdrive.control.signals import Command
from adaptdrive.hardware.canopen.dictionary import label
from adaptdrive.hardware.canopen.mapping import CanOpenMapping, CommandPdo
from adaptdrive.hardware.canopen.profile import CONTROLWORD
from adaptdrive.hardware.canopen.setup import SYNC_COB_ID
from adaptdrive.hardware.rival import Rival

_CONTROLWORD = label(CONTROLWORD)

_SDO_WRITES = frozenset({0, 1, 6})
"""Client command specifiers of SDO frames that write: segment, initiate and block download."""


def command_frames(
    mapping: CanOpenMapping, command: Command, word: int
) -> Iterator[tuple[int, bytes]]:
    """Encode a command as PDOs.

    Args:
        mapping: Objects of the drive.
        command: The command.
        word: Controlword.

    Raises:
        ValueError: A value is not finite, or its object cannot hold it.
    """
    for order in mapping.orders:
        yield order.codec.frame_id, order.codec.encode(_values(order, command, word))


class ForeignCommands:
    """Detects commands of another sender; no bus returns the frames that this port sends.

    Attributes:
        names: Name of each frame that commands the drive, by id.
    """

    def __init__(self, mapping: CanOpenMapping, config: CanOpenBus, rival: Rival) -> None:
        self._sdo = 0x600 + config.node_id
        self._rival = rival
        names = {order.codec.frame_id: order.codec.name for order in mapping.orders}
        names[self._sdo] = "SDO write"
        names[0x700 + config.own_node_id] = "heartbeat of another node with bus.own_node_id"
        if config.sync == "daemon":
            names[SYNC_COB_ID] = "SYNC of another node"
        self.names = {can_id: f"0x{can_id:03X} ({name})" for can_id, name in names.items()}

    def hear(self, frame: can.Message) -> bool:
        """Report a foreign frame that commands this drive; return whether it does.

        A heartbeat under the daemon's own id does, too: the drive would obey its last command for
        as long as that node lives, however long ago this daemon has died. Nor may another node send
        SYNC where this daemon does: control would run too fast. A frame that reads objects is no
        command. Nor is NMT: a node that it stops or restarts reports that itself.
        """
        can_id, data = frame.arbitration_id, frame.data
        reads = can_id == self._sdo and not (data and data[0] >> 5 in _SDO_WRITES)
        if can_id not in self.names or reads:
            return False
        self._rival.hear(self.names[can_id])
        return True

    def writes_objects(self, frame: can.Message) -> bool:
        """Return whether a foreign frame that commands this drive writes one of its objects.

        Args:
            frame: A frame that `hear` has reported.
        """
        return frame.arbitration_id == self._sdo


def _values(order: CommandPdo, command: Command, word: int) -> dict[str, float | None]:
    """Return the values of a PDO: its part of the command, and the controlword if mapped."""
    values: dict[str, float | None] = {sink.item.label: sink.value(command) for sink in order.sinks}
    if order.controlword:
        values[_CONTROLWORD] = word
    return values
