"""The object dictionary of the simulated CiA 402 drive, and the PDOs that it describes.

What a PDO carries stands in the dictionary, where the daemon has written it: nothing here reads the
daemon's configuration. As in a real drive, a mapping can be changed only while its PDO is invalid
and its count is 0, and only to objects that the EDS lets travel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace

import canopen
from canopen.objectdictionary import ODVariable
from canopen.objectdictionary.datatypes import FLOAT_TYPES, SIGNED_TYPES
from canopen.sdo.exceptions import SdoAbortedError

from adaptdrive.devices.field import natural_limits

Address = tuple[int, int]

_RECEIVE, _TRANSMIT, _BEHIND = 0x1400, 0x1800, 0x1C00
_MAPPING = 0x200
_INVALID = 1 << 31
_LONGEST_BITS = 64

_NOT_MAPPABLE, _TOO_LONG, _NOT_NOW = 0x06040041, 0x06040042, 0x08000022


class NodeNetwork(canopen.Network):
    """The bus as the canopen library sees it."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self._send = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: FBT002 - canopen's
        """Send one frame; this drive never makes a remote request."""
        del remote
        self._send(can_id, bytes(data))

    def send_periodic(self, *_: object, **__: object) -> SimpleNamespace:  # type: ignore[override]
        """Heartbeats follow the half cycles: the library's own thread is not wanted."""
        return SimpleNamespace(update=lambda _: None, stop=lambda: None)


class Objects:
    """The object dictionary, with an SDO server."""

    def __init__(self, eds: str, node_id: int, wire: NodeNetwork) -> None:
        """Read the EDS and serve it.

        Args:
            eds: Path of the EDS.
            node_id: Node id.
            wire: Where the SDO server's replies go, and its requests come from.
        """
        self._node = canopen.LocalNode(node_id, eds)
        self._node.associate_network(wire)
        self._node.add_write_callback(self._check_mapping)

    def reset(self) -> None:
        """Back to the values of the EDS."""
        self._node.data_store.clear()

    def number(self, address: Address) -> float:
        """The raw value of an entry, 0 for one that is not there."""
        variable = self._variable(address)
        if variable is None:
            return 0
        value = variable.decode_raw(self._node.get_data(*address))
        if not isinstance(value, int | float):
            raise TypeError(f"{address} is no number")
        return value

    def put(self, address: Address, value: float) -> None:
        """Set an entry; like a converter's, a value ends at what its type holds."""
        variable = self._variable(address)
        if variable is None:
            return
        if variable.data_type not in FLOAT_TYPES:
            signed = variable.data_type in SIGNED_TYPES
            low, high = natural_limits(len(variable), signed=signed, real=False)
            value = min(max(round(value), low), high)
        self._node.set_data(*address, variable.encode_raw(value))

    def transmit_pdos(self) -> Iterator[tuple[int, bytes]]:
        """Frame id and content of each valid PDO that follows each SYNC."""
        for index, cob_id in self._valid(_TRANSMIT):
            if self.number((index, 2)) == 1:
                word, length = 0, 0
                for address, bits in self._mapped(index):
                    raw = int.from_bytes(self._node.get_data(*address), "little")
                    word |= raw << length
                    length += bits
                yield cob_id, word.to_bytes((length + 7) // 8, "little")

    def take_pdo(self, can_id: int, data: bytes) -> bool:
        """Take the content of a PDO; False when it is none of ours, or too short."""
        index = next((one for one, cob_id in self._valid(_RECEIVE) if cob_id == can_id), None)
        entries = [] if index is None else self._mapped(index)
        if index is None or 8 * len(data) < sum(bits for _, bits in entries):
            return False
        word = int.from_bytes(data, "little")
        for address, bits in entries:
            raw = word & ((1 << bits) - 1)
            self._node.set_data(*address, raw.to_bytes(bits // 8, "little"))
            word >>= bits
        return True

    def _valid(self, index: int) -> Iterator[tuple[int, int]]:
        while self._variable((index, 1)) is not None:
            cob_id = int(self.number((index, 1)))
            if not cob_id & _INVALID:
                yield index, cob_id & 0x7FF
            index += 1

    def _mapped(self, communication: int) -> list[tuple[Address, int]]:
        index = communication + _MAPPING
        words = [int(self.number((index, one + 1))) for one in range(int(self.number((index, 0))))]
        return [((word >> 16, word >> 8 & 0xFF), word & 0xFF) for word in words]

    def _check_mapping(self, *, index: int, subindex: int, data: bytes, **_: object) -> None:
        """Refuse what a drive refuses.

        Raises:
            SdoAbortedError: The mapping cannot be changed now, or not to that.
        """
        communication = index - _MAPPING
        if not (_RECEIVE <= communication < _BEHIND) or communication & _MAPPING:
            return
        if not int(self.number((communication, 1))) & _INVALID:
            raise SdoAbortedError(_NOT_NOW)
        value = int.from_bytes(data, "little")
        if subindex == 0:
            bits = sum(int(self.number((index, one + 1))) & 0xFF for one in range(value))
            if bits > _LONGEST_BITS:
                raise SdoAbortedError(_TOO_LONG)
            return
        if self.number((index, 0)) != 0:
            raise SdoAbortedError(_NOT_NOW)
        variable = self._variable((value >> 16, value >> 8 & 0xFF))
        if variable is None or not variable.pdo_mappable or len(variable) != value & 0xFF:
            raise SdoAbortedError(_NOT_MAPPABLE)

    def _variable(self, address: Address) -> ODVariable | None:
        return self._node.object_dictionary.get_variable(*address)
