"""The state machine of CiA 402 (IEC 61800-7-201): statusword in, controlword out.

A drive is brought up one transition at a time, each only once its statusword shows the one before:

    switch on disabled → ready to switch on → switched on → operation enabled

It is energised from rest only. One that falls back by itself, into a fault, a quick stop or a lower
state, is commanded to disable its voltage and is not brought up again before a safe command.
A fault is reset by an edge of bit 7, and only when that is asked for.
"""

import math
from collections.abc import Iterator
from enum import IntEnum, StrEnum
from functools import cache
from typing import Final

from adaptdrive.config.timing import Timing
from adaptdrive.control.signals import Command

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


class Goal(IntEnum):
    """Degree to which a command switches the drive on."""

    REST = 0
    SWITCHED_ON = 2
    ENABLED = 3


_LADDER = ("SWITCH_ON_DISABLED", "READY", "SWITCHED_ON", "ENABLED")
_RUNGS = {DriveState[name]: rung for rung, name in enumerate(_LADDER)}
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


def goal_of(command: Command) -> Goal:
    """Return the degree to which a command switches the drive on."""
    if command.bridge:
        return Goal.ENABLED
    if command.current_scale_S or command.boost_reference_V:
        return Goal.SWITCHED_ON
    return Goal.REST


class DriveControl:
    """Follows one drive's state, and derives the next controlword.

    Attributes:
        state: State heard last, None before the first.
        powered: Whether the power stage may be on, by the state heard last, also a forgotten one.
        fallen: Why the drive is not brought up any further, None while all is well.
    """

    def __init__(self) -> None:
        self.state: DriveState | None = None
        self.powered = False
        self.fallen: str | None = None
        self._goal = Goal.REST
        self._rested = False
        self._reached = 0
        self._resets: Iterator[int] = iter(())

    @property
    def faulty(self) -> bool:
        """True if the drive is in a fault, or reacts to one."""
        return self.state in _FAULTS

    def hear(self, statusword: int) -> None:
        """Take the drive's state."""
        self.state = state = state_of(statusword)
        self.powered = state in POWERED
        if state is DriveState.SWITCH_ON_DISABLED:
            self._rested = True
        if self._goal is Goal.REST or not self._rested:
            return
        rung = _RUNGS.get(state)
        if rung is None or rung < self._reached:
            self.fall(f"the drive left its state by itself: {state}")
        else:
            self._reached = min(rung, self._goal)

    def fall(self, reason: str) -> None:
        """Bring an energised drive to rest, and keep it there until it is commanded safe."""
        if self._goal is not Goal.REST and self.fallen is None:
            self.fallen = reason

    def forget(self) -> None:
        """Nothing is known of the drive any more: it begins from rest again."""
        self.state, self._rested = None, False

    def ask_reset(self) -> None:
        """Let the coming controlwords reset a fault, if there is one."""
        self._resets = iter(_RESET)

    def controlword(self, command: Command) -> int:
        """The word to send with a command.

        Args:
            command: Command to the drive.
        """
        goal = goal_of(command)
        if goal is Goal.REST:
            return self._rest()
        self._goal, self._resets = goal, iter(())
        self._reached = min(self._reached, goal)
        if self.fallen or not self._rested:
            return DISABLE_VOLTAGE
        return _UP[min(self._reached, goal - 1)]

    def _rest(self) -> int:
        if self._goal is not Goal.REST:
            self._goal, self._rested, self._reached = Goal.REST, False, 0
        self.fallen = None
        word = next(self._resets, DISABLE_VOLTAGE)
        if word == FAULT_RESET and self.state is not DriveState.FAULT:
            self._resets = iter(())  # nor does it reset a fault that comes later
            return DISABLE_VOLTAGE
        return word


class UnseenStop:
    """Watches the time between two statuswords of a drive that is commanded to enable operation.

    A drive that was on is not driven on before it has reported again. One that was only commanded
    on may be yet to come on, or have stopped, where it reports *switched on* after a silence in
    which its own time-out may have ended: it falls.
    """

    def __init__(self, control: DriveControl, timing: Timing) -> None:
        """Expect no statusword yet.

        Args:
            control: Follows the statusword.
            timing: Times of the drive; each reading has a statusword.
        """
        self._control = control
        self._limit_s = timing.reported_seldom_s
        self._heard_s = math.inf
        self._commanded_on = False

    def hear(self, heard_s: float) -> None:
        """Take the arrival of a statusword, which the control has heard."""
        if self._control.state is not DriveState.ENABLED:
            self.look(heard_s)
        self._heard_s = heard_s

    def look(self, now_s: float) -> None:
        """Let a drive fall that has been silent for too long, before it is commanded."""
        silent_s = now_s - self._heard_s
        if self._commanded_on and silent_s > self._limit_s:
            self._control.fall(
                "the drive left its state by itself, or may have: nothing was heard of it for "
                f"{silent_s * 1e3:.0f} ms while it was commanded on"
            )

    def note(self, controlword: int) -> None:
        """Take the controlword that is sent."""
        self._commanded_on = controlword == ENABLE_OPERATION
