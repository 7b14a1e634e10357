"""What an emergency (EMCY) frame says, in words: error codes of CiA 301 and CiA 402."""

from __future__ import annotations

from dataclasses import dataclass

LENGTH = 8

_CLASSES = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current, device input side",
    0x22: "current inside the device",
    0x23: "current, device output side",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "temperature of the device",
    0x43: "temperature of the drive",
    0x44: "temperature of the supply",
    0x50: "device hardware",
    0x51: "supply of the device",
    0x52: "control hardware",
    0x54: "power section",
    0x60: "device software",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set",
    0x70: "additional modules",
    0x71: "power modules",
    0x72: "measurement circuit",
    0x73: "sensor",
    0x75: "communication module",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x83: "torque control",
    0x84: "velocity control",
    0x85: "position control",
    0x86: "positioning",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "device specific",
}
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
        """Whether the frame says that there is no error any more."""
        return self.code >> 8 == 0

    def __str__(self) -> str:
        words = _SINGLE.get(self.code) or _CLASSES.get(self.code >> 8)
        words = words or _CLASSES.get(self.code >> 8 & 0xF0, "unknown")
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
