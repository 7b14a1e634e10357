"""Proofs that a frame is whole and alive: checksums and alive counters.

Both checksums use the polynomial x⁸+x⁴+x³+x²+1 (0x1D), most significant bit first, over every byte
of the frame but the one that holds the checksum:

* `sae-j1850`: start value 0xFF, final XOR 0xFF.
* `autosar-p01`: end-to-end profile 1: start value 0, no final XOR, over the data id and then the
  frame. Of the data id come its low byte and its high byte (`both`), its low byte alone (`low`),
  its low byte with an even and its high byte with an odd alive counter (`alternating`), or its low
  byte and a zero, while the lower half of its high byte travels in the frame (`nibble`).
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

from adaptdrive.config.bus import FrameIntegrity

Checksum = Callable[[bytes, int], int]
"""From a frame without its checksum, and its alive counter, to the checksum."""


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


def checksum_function(integrity: FrameIntegrity) -> Checksum:
    """The checksum of a message.

    Args:
        integrity: Its form, and the data id of AUTOSAR profile 1; SAE J1850 has none.
    """
    if integrity.algorithm == "sae-j1850":
        return lambda data, _: crc8(data, 0xFF) ^ 0xFF
    low, high = integrity.data_id.to_bytes(2, "little")
    if integrity.data_id_mode == "alternating":
        starts = crc8(bytes((low,)), 0x00), crc8(bytes((high,)), 0x00)
        return lambda data, counter: crc8(data, starts[counter % 2])
    begin = {"both": (low, high), "low": (low,), "nibble": (low, 0)}[integrity.data_id_mode]
    start = crc8(bytes(begin), 0x00)
    return lambda data, _: crc8(data, start)


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
