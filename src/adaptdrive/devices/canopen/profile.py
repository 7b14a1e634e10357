"""The state machine of CiA 402 (IEC 61800-7-201): statusword in, controlword out.

A drive is brought up one transition at a time, each only once its statusword shows the one before:

    switch on disabled → ready to switch on → switched on → operation enabled

It is energised from rest only. One that falls back by itself, into a fault, a quick stop or a lower
state, is commanded to disable its voltage and is not brought up again before a safe command.
A fault is reset by an edge of bit 7, and only when that is asked for.
"""

from collections.abc import Iterator
from enum import StrEnum
from functools import cache
from typing import Final

from canopen.emcy import EmcyError

from adaptdrive.control.signals import Command
from adaptdrive.safety.trips import Trip, TripKind

CONTROLWORD = (0x6040, 0)
STATUSWORD = (0x6041, 0)

DISABLE_VOLTAGE = 0x0000
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE_OPERATION = 0x000F
FAULT_RESET = 0x0080
CONTROLWORDS = (DISABLE_VOLTAGE, SHUTDOWN, SWITCH_ON, ENABLE_OPERATION, FAULT_RESET)

_RESET = (DISABLE_VOLTAGE, *[FAULT_RESET] * 30)
"""Words that reset a fault: an edge, and a bit that stays up until a drive that takes its words
with SYNC has seen it."""


class DriveState(StrEnum):
    """State of a CiA 402 drive by its statusword."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"


_LADDER = ("SWITCH_ON_DISABLED", "READY", "SWITCHED_ON", "ENABLED")
_RUNGS = {DriveState[name]: rung for rung, name in enumerate(_LADDER)}
_REST, _SWITCHED_ON, _ENABLED = 0, 2, 3
"""Rungs to which a command switches the drive on."""

_UP = (SHUTDOWN, SWITCH_ON, ENABLE_OPERATION)
"""Words that lead from each rung to the next one; the last one up to a goal also holds it."""

_FAULTS = frozenset({DriveState.FAULT, DriveState.FAULT_REACTION})

POWERED: Final = frozenset(
    {DriveState.ENABLED, DriveState.QUICK_STOP, DriveState.FAULT_REACTION, DriveState.UNKNOWN}
)
"""States in which the power stage may drive the load: in a quick stop and in the reaction to a
fault it ramps the load down, and a word that names no state does not say that it is off."""

_WORDS = {
    DriveState.NOT_READY: (0x4F, 0x00),
    DriveState.SWITCH_ON_DISABLED: (0x4F, 0x40),
    DriveState.FAULT_REACTION: (0x4F, 0x0F),
    DriveState.FAULT: (0x4F, 0x08),
    DriveState.READY: (0x6F, 0x21),
    DriveState.SWITCHED_ON: (0x6F, 0x23),
    DriveState.ENABLED: (0x6F, 0x27),
    DriveState.QUICK_STOP: (0x6F, 0x07),
}
"""Bits of a statusword that name a state, and their value in it."""


@cache
def state_of(statusword: int) -> DriveState:
    """The state that a statusword shows; bits that do not name a state are left aside."""
    found = (state for state, (mask, value) in _WORDS.items() if statusword & mask == value)
    return next(found, DriveState.UNKNOWN)


class DriveControl:
    """Follows one drive's state, and derives the next controlword.

    Attributes:
        state: State reported last, None before the first.
        fallen: Why the drive is not brought up any further, None while all is well.
    """

    def __init__(self) -> None:
        """Expect no statusword yet."""
        self.state: DriveState | None = None
        self.fallen: Trip | None = None
        self._goal = _REST
        self._rested = False
        self._reached = 0
        self._resets: Iterator[int] = iter(())

    @property
    def faulty(self) -> bool:
        """True if the drive is in a fault, or reacts to one."""
        return self.state in _FAULTS

    def follow(self, statusword: int) -> None:
        """Take the drive's state from its statusword."""
        self.state = state = state_of(statusword)
        if state is DriveState.SWITCH_ON_DISABLED:
            self._rested = True
        if self._goal != _REST and self._rested:
            rung = _RUNGS.get(state)
            if rung is None or rung < self._reached:
                left = f"the drive left its state by itself: {state}"
                self.fall(Trip(TripKind.STATE_LEFT, left))
            else:
                self._reached = min(rung, self._goal)

    def fall(self, reason: Trip) -> None:
        """Bring an energised drive to rest, and keep it there until it is commanded safe."""
        if self._goal != _REST and self.fallen is None:
            self.fallen = reason

    def forget(self) -> None:
        """Nothing is known of the drive any more: it begins from rest again."""
        self.state, self._rested = None, False

    def ask_reset(self) -> None:
        """Let the coming controlwords reset a fault, if there is one."""
        self._resets = iter(_RESET)

    def controlword(self, command: Command) -> int:
        """Return the word to send with a command to the drive."""
        goal = _REST
        if command.bridge:
            goal = _ENABLED
        elif command.current_scale_S or command.boost_reference_V:
            goal = _SWITCHED_ON
        if goal == _REST:
            return self._rest()
        self._goal, self._resets = goal, iter(())
        self._reached = min(self._reached, goal)
        if self.fallen or not self._rested:
            return DISABLE_VOLTAGE
        return _UP[min(self._reached, goal - 1)]

    def _rest(self) -> int:
        if self._goal != _REST:
            self._goal, self._rested, self._reached = _REST, False, 0
        self.fallen = None
        word = next(self._resets, DISABLE_VOLTAGE)
        if word == FAULT_RESET and self.state is not DriveState.FAULT:
            self._resets = iter(())  # nor does it reset a fault that comes later
            return DISABLE_VOLTAGE
        return word


# Emergency (EMCY) frames in words: classes of CiA 301 by the library, single codes of CiA 402.

_CODE_BYTES = 2
"""Least bytes of an emergency: some drives send the code alone, without register and detail."""

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


class Emergency(EmcyError):  # noqa: N818 - never raised
    """One emergency: the library's `code`, `register` 0x1001 and `data`, which the maker adds."""

    @property
    def over(self) -> bool:
        """True if the frame reports the end of all errors."""
        return self.code >> 8 == 0

    def __str__(self) -> str:
        words = _SINGLE.get(self.code) or self.get_desc().lower() or "unknown"
        more = "" if self.register < 0 else f" (error register 0x{self.register:02X})"
        return f"emergency 0x{self.code:04X}, {words}{more}"


def parse_emergency(data: bytes) -> Emergency | None:
    """Read an emergency frame.

    Args:
        data: Its bytes.

    Returns:
        The emergency, whose register is -1 where the frame ends before it; None for a frame
        without a whole code.
    """
    if len(data) < _CODE_BYTES:
        return None
    code, register = int.from_bytes(data[:_CODE_BYTES], "little"), (*data[2:3], -1)[0]
    return Emergency(code, register, data[3:], 0.0)
