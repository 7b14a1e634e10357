"""Proofs that a frame is whole, alive and in time: checksums, alive counters, arrival times.

crccheck works bit by bit and takes 5 to 9 µs for 7 bytes and 45 to 54 µs for 63; these tables take
0.5 to 0.7 µs and 3 to 7 µs. The tests compare both over crccheck's whole catalogue.

Two checksums need no parameters. Both use the polynomial x⁸+x⁴+x³+x²+1 (0x1D), most significant bit
first, over every byte of the frame but the one that holds the checksum:

* SAE J1850: start value 0xFF, final XOR 0xFF.
* AUTOSAR end-to-end profile 1, where there is a `data_id`: start value 0, no final XOR, over the
  data id and then the frame. Of the data id come its low byte and its high byte (`both`), its low
  byte alone (`low`), its low byte with an even and its high byte with an odd alive counter
  (`alternating`), or its low byte and a zero, while the lower half of its high byte travels in the
  frame (`nibble`).

Every other one is described by its parameters (`crc`).

The kernel stamps a frame with the wall clock, which may be set while the frame waits to be read.
The offset between both clocks is measured at each frame. No frame has waited since before its
queue was last found empty: however long that is, and whatever its stamp is. Where the wall clock
was set meanwhile, each frame that is read until the queue is empty counts as that old.
"""

import time
from collections.abc import Callable
from enum import StrEnum
from typing import Final, Literal

import can

from adaptdrive.config.bus import Crc, FrameIntegrity

# Cyclic redundancy checks by the parameters under which catalogues list them.


def crc_function(form: Crc, width: int, before: bytes = b"") -> Callable[[bytes], int]:
    """Return the function from bytes to their checksum.

    Args:
        form: The parameters.
        width: Bits of the checksum.
        before: Bytes that the checksum always runs over first.
    """
    kind = _mirrored if form.reflected else _plain if width > 8 else _single
    run = kind(form.poly, width)
    init = _mirror(form.init, width) if form.reflected else form.init
    start, xorout = run(before, init), form.xorout
    return lambda data: run(data, start) ^ xorout


def _single(poly: int, width: int) -> Callable[[bytes, int], int]:
    """Highest bit first, in a register of one byte."""
    table = tuple(_shifted_out(byte, poly, width) for byte in range(256))

    def run(data: bytes, register: int) -> int:
        for byte in data:
            register = table[register ^ byte]
        return register

    return run


def _plain(poly: int, width: int) -> Callable[[bytes, int], int]:
    """Highest bit first."""
    shift, mask = width - 8, (1 << width) - 1
    table = tuple(_shifted_out(byte << shift, poly, width) for byte in range(256))

    def run(data: bytes, register: int) -> int:
        for byte in data:
            register = (register << 8 & mask) ^ table[register >> shift ^ byte]
        return register

    return run


def _mirrored(poly: int, width: int) -> Callable[[bytes, int], int]:
    """Lowest bit first, with the whole register mirrored."""
    shift = width - 8
    table = tuple(
        _mirror(_shifted_out(_mirror(byte, 8) << shift, poly, width), width) for byte in range(256)
    )

    def run(data: bytes, register: int) -> int:
        for byte in data:
            register = register >> 8 ^ table[register & 0xFF ^ byte]
        return register

    return run


def _shifted_out(register: int, poly: int, width: int) -> int:
    """The register after eight more bits."""
    top = 1 << width - 1
    for _ in range(8):
        register = register << 1 ^ (poly if register & top else 0)
    return register & (1 << width) - 1


def _mirror(value: int, width: int) -> int:
    return int(f"{value:0{width}b}"[::-1], 2)


# Proofs that a frame is whole and alive: checksums and alive counters.

Checksum = Callable[[bytes, int], int]
"""From the bytes that a checksum covers, and the frame's alive counter, to the checksum."""

_SAE_J1850 = Crc(poly=0x1D, init=0xFF, xorout=0xFF)
_AUTOSAR_P01 = Crc(poly=0x1D)


Span = tuple[int, int, Literal["little", "big"]]
"""Position of a checksum in its frame, which are whole bytes: the first one, the one behind the
last one, and their order."""


def checksum_function(integrity: FrameIntegrity, width: int = 8) -> Checksum:
    """Return the checksum of a message.

    Args:
        integrity: Its form.
        width: Bits of the checksum.
    """
    if integrity.data_id is not None:
        return _profile_1(integrity, *integrity.data_id.to_bytes(2, "little"))
    form = integrity.crc or _SAE_J1850
    crc, after = crc_function(form, width, bytes(form.before)), bytes(form.after)
    if form.by_counter:
        last = [after + bytes((byte,)) for byte in form.by_counter]
        return lambda data, counter: crc(data + last[counter % len(last)])
    return (lambda data, _: crc(data + after)) if after else (lambda data, _: crc(data))


def _profile_1(integrity: FrameIntegrity, low: int, high: int) -> Checksum:
    if integrity.data_id_mode == "alternating":
        even, odd = (crc_function(_AUTOSAR_P01, 8, bytes((byte,))) for byte in (low, high))
        return lambda data, counter: odd(data) if counter % 2 else even(data)
    whole = (low, 0) if integrity.nibble else (low, high)
    crc = crc_function(_AUTOSAR_P01, 8, bytes(whole[: 1 if integrity.data_id_mode == "low" else 2]))
    return lambda data, _: crc(data)


class FrameVerdict(StrEnum):
    """Result of the checks of a frame; a refusal is named after the count that it adds to."""

    GOOD = "good"
    WRONG_LENGTH = "wrong_length"
    WRONG_CHECKSUM = "wrong_checksum"
    COUNTER_STUCK = "counter_stuck"
    COUNTER_LOST = "counter_lost"
    OUT_OF_RANGE = "out_of_range"


_GOOD: Final[FrameVerdict] = FrameVerdict.GOOD  # found at once by compiled code


MAX_JUMP = 3
"""Largest accepted advance of an alive counter: two lost frames in a row are no other sender."""

_RECENT_SHARE = 4
_RECENT_FRAMES = 8
_RECENT_S = 0.1
"""The newest counters are old ones: a quarter of the range, and eight at the most, of a time that a
sender that starts anew among them can lose."""

_BUFFERED_FRAMES = 16
"""Frames that a gateway may hold: a counter that falls back further is that of a restart."""


class AliveCounter:
    """Follows the alive counter of one message.

    A counter that stands still is a repeated frame. One that leaps further than `max_jump` is
    refused. So are those after it, until one is the very next of the one before: a restarted sender
    loses one frame, and of two senders that take turns neither is accepted.

    Frames that are repeated in turn are each the next of the one before, too. A counter among the
    newest ones is refused until one is ahead of them. One that falls back a little further is
    followed once, as that of a restarted sender. Where one falls back again before any was ahead of
    the highest, all from there on are refused until one is.
    """

    def __init__(self, modulus: int, max_jump: int, cycle_s: float = 0.0) -> None:
        """Start without a frame.

        Args:
            modulus: Where the counter wraps.
            max_jump: Largest accepted advance.
            cycle_s: Time from one frame to the next, 0 for a message of each half cycle.
        """
        self._modulus = modulus
        self._max_jump = max_jump
        self._back = max(0, min(_BUFFERED_FRAMES, modulus // 2 - 1, modulus - 1 - max_jump))
        most = _RECENT_FRAMES if cycle_s <= 0.0 else max(1, int(_RECENT_S / cycle_s))
        self._recent = min(most, _RECENT_FRAMES, modulus // _RECENT_SHARE, self._back + 1) - 1
        self._newest = 0
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next counter is the first one."""
        self._last: int | None = None
        self._below = -1  # how far the newest counter is below the highest one, none above it: -1
        self._leapt = self._resumed = False

    def check(self, value: int) -> tuple[FrameVerdict, int]:
        """Compare a counter with those before it.

        Args:
            value: The counter of the frame at hand, 0…modulus-1.

        Returns:
            The verdict, and how many frames went missing before this one.
        """
        if self._last is None:
            self._last = self._newest = value
            return _GOOD, 0
        jump = (value - self._last) % self._modulus
        if jump == 0:
            return FrameVerdict.COUNTER_STUCK, 0
        self._last = value
        behind = (self._newest - value) % self._modulus
        if behind <= (self._recent if self._below < 0 else self._back):
            self._leapt = True
            return FrameVerdict.COUNTER_LOST, jump - 1
        first = behind <= self._back  # the first one that falls back
        self._below = behind if first else max(-1, self._below - self._modulus + behind)
        self._newest = value
        if self._resumed:
            self._leapt = self._resumed = False
            return _GOOD, 0
        self._leapt = jump > (1 if self._leapt else self._max_jump)
        return FrameVerdict.COUNTER_LOST if self._leapt else _GOOD, jump - 1

    def resume(self) -> None:
        """Accept any next counter but the newest ones: a repeated frame stays one after a pause."""
        self._leapt, self._resumed = False, self._last is not None


# Arrival time of a frame at the machine, by the monotonic clock.

PROMPT_S = 0.002
"""A clocking frame that has waited for less than this has no successor yet: half cycles last."""

_STEP_S = 0.001
"""Change of the offset from one frame to the next that is a step: slewing by NTP changes it by 5 µs
in 10 ms."""

_LOOKS = 3
"""Attempts to read both clocks without being interrupted for `_STEP_S` between them."""


class ArrivalClock:
    """Converts the stamps of frames from the wall clock to the monotonic clock."""

    def __init__(
        self, clock: Callable[[], float], wall_clock: Callable[[], float] = time.time
    ) -> None:
        """Measure the offset between both clocks.

        Args:
            clock: Monotonic clock, in seconds.
            wall_clock: The clock with which the bus stamps frames, in seconds.
        """
        self._clock = clock
        self._wall_clock = wall_clock
        self._empty_s, self._offset_s = self._look()
        self._drain_s = self._empty_s
        self._stepped = False

    def begin_drain(self) -> None:
        """Note that the queue is about to be opened, or read until it is empty."""
        self._drain_s = self._clock()

    def end_drain(self) -> None:
        """Note that the queue is empty; what comes now came after its reading began."""
        self._empty_s = self._drain_s
        self._stepped = False

    def waited_s(self, frame: can.Message) -> float:
        """Return for how long a frame has waited to be read, 0 where that is not known.

        A frame that waited while the loop was busy must not look as fresh as one that was read at
        once.
        """
        if not frame.timestamp:
            return 0.0
        now_s, offset_s = self._look()
        self._stepped = self._stepped or abs(offset_s - self._offset_s) > _STEP_S
        self._offset_s = offset_s
        longest_s = now_s - self._empty_s
        if self._stepped:
            return longest_s
        return min(max(now_s - (frame.timestamp - offset_s), 0.0), longest_s)

    def _look(self) -> tuple[float, float]:
        """Return the monotonic time, and how far the wall clock is ahead of it."""
        for _ in range(_LOOKS):
            before_s = self._clock()
            wall_s = self._wall_clock()
            now_s = self._clock()
            if now_s - before_s < _STEP_S:
                break
        return now_s, wall_s - now_s
