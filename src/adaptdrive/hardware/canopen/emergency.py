"""Emergency (EMCY) frames in words: classes of CiA 301 by the library, single codes of CiA 402."""

from __future__ import annotations

from dataclasses import dataclass

from canopen.emcy import EmcyError

LENGTH = 8

_SINGLE = {
    0x2310: "continuous over-current at the output",
    0x2320: "short circuit at the output",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "mains phase failure",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "excess temperature of the device",
    0x4310: "excess temperature of the drive",
    0x8130: "heartbeat of the daemon lost",
    0x8140: "recovered from bus off",
}


@dataclass(frozen=True, slots=True)
class Emergency:
    """One emergency.

    Attributes:
        code: Error code.
        register: Error register 0x1001.
        detail: What the manufacturer adds.
    """

    code: int
    register: int
    detail: bytes

    @property
    def over(self) -> bool:
        """True if the frame reports the end of all errors."""
        return self.code >> 8 == 0

    def __str__(self) -> str:
        kind = EmcyError(self.code, self.register, self.detail, 0.0).get_desc().lower()
        words = _SINGLE.get(self.code) or kind or "unknown"
        return f"emergency 0x{self.code:04X}, {words} (error register 0x{self.register:02X})"


def parse_emergency(data: bytes) -> Emergency | None:
    """Read an emergency frame.

    Args:
        data: Its bytes.

    Returns:
        The emergency, None when the frame has not its eight bytes.
    """
    if len(data) != LENGTH:
        return None
    return Emergency(int.from_bytes(data[:2], "little"), data[2], data[3:])
