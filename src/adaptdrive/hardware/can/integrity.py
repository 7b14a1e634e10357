"""Proofs that a frame is whole and alive: checksums and alive counters.

Both checksums use the polynomial x⁸+x⁴+x³+x²+1 (0x1D), most significant bit first, over every byte
of the frame but the one that holds the checksum:

* `sae-j1850`: start value 0xFF, final XOR 0xFF.
* `autosar-p01`: end-to-end profile 1 with both bytes of the data id: start value 0, no final XOR,
  over the low byte of the data id, its high byte, and then the frame.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Literal

Checksum = Callable[[bytes], int]


def _table(polynomial: int) -> bytes:
    return bytes(_shifted_out(byte, polynomial) for byte in range(256))


def _shifted_out(byte: int, polynomial: int) -> int:
    for _ in range(8):
        byte = (byte << 1) ^ (polynomial if byte & 0x80 else 0)
    return byte & 0xFF


_TABLE = _table(0x11D)


def crc8(data: bytes, start: int) -> int:
    """CRC-8 with the polynomial 0x1D, without a final XOR.

    Args:
        data: Bytes to run over.
        start: Start value of the register.
    """
    register = start
    for byte in data:
        register = _TABLE[register ^ byte]
    return register


def sae_j1850(data: bytes) -> int:
    """CRC-8 SAE J1850 of `data`."""
    return crc8(data, 0xFF) ^ 0xFF


def checksum_function(algorithm: Literal["sae-j1850", "autosar-p01"], data_id: int) -> Checksum:
    """The checksum of a message.

    Args:
        algorithm: Form of the checksum.
        data_id: Data id of AUTOSAR profile 1; SAE J1850 has none.

    Returns:
        A function from the bytes of a frame, without its checksum, to the checksum.
    """
    if algorithm == "sae-j1850":
        return sae_j1850
    start = crc8(data_id.to_bytes(2, "little"), 0x00)
    return lambda data: crc8(data, start)


class Verdict(StrEnum):
    """What the checks say about a frame; a refusal is named after the count that it adds to."""

    GOOD = "good"
    WRONG_LENGTH = "wrong_length"
    WRONG_CHECKSUM = "wrong_checksum"
    COUNTER_STUCK = "counter_stuck"
    COUNTER_LOST = "counter_lost"
    OUT_OF_RANGE = "out_of_range"


class AliveCounter:
    """Follows the alive counter of one message.

    A counter that stands still is a repeated frame. One that leaps further than `max_jump` is not
    believed, but becomes the new start, so that one refusal is the price of a restarted sender.
    """

    def __init__(self, modulus: int, max_jump: int) -> None:
        self._modulus = modulus
        self._max_jump = max_jump
        self._last: int | None = None

    def check(self, value: int) -> tuple[Verdict, int]:
        """Compare a counter with the one before it.

        Args:
            value: The counter of the frame at hand, 0…modulus-1.

        Returns:
            The verdict, and how many frames went missing before this one.
        """
        if self._last is None:
            self._last = value
            return Verdict.GOOD, 0
        jump = (value - self._last) % self._modulus
        if jump == 0:
            return Verdict.COUNTER_STUCK, 0
        self._last = value
        verdict = Verdict.GOOD if jump <= self._max_jump else Verdict.COUNTER_LOST
        return verdict, jump - 1

    def reset(self) -> None:
        """Forget the past: the next counter is the first one."""
        self._last = None
