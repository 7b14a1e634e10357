"""The state machine of CiA 402 as a drive runs it: controlwords in, statusword out.

One controlword makes one transition. A fault is left by an edge of bit 7 only, and only when its
cause is gone.
"""

from __future__ import annotations

from enum import IntEnum

_SWITCH_ON, _ENABLE_VOLTAGE, _NO_QUICK_STOP, _ENABLE, _RESET = 0x01, 0x02, 0x04, 0x08, 0x80


class PowerState(IntEnum):
    """States by their statusword; bit 4 means that the line current may flow."""

    SWITCH_ON_DISABLED = 0x0040
    READY = 0x0021
    SWITCHED_ON = 0x0033
    ENABLED = 0x0037
    FAULT = 0x0008


class PowerStates:
    """State of the drive.

    Attributes:
        state: The present state.
    """

    def __init__(self) -> None:
        self.state = PowerState.SWITCH_ON_DISABLED
        self._reset = False

    @property
    def charging(self) -> bool:
        """True if line current may flow."""
        return self.state in {PowerState.SWITCHED_ON, PowerState.ENABLED}

    def obey(self, controlword: int, *, healthy: bool) -> None:
        """Make the transition that a controlword asks for, if there is one."""
        edge = bool(controlword & _RESET) and not self._reset
        self._reset = bool(controlword & _RESET)
        if self.state is PowerState.FAULT:
            if edge and healthy:
                self.state = PowerState.SWITCH_ON_DISABLED
            return
        self.state = self._next(controlword)

    def disable_voltage(self) -> None:
        """Leave everything but a fault at once."""
        if self.state is not PowerState.FAULT:
            self.state = PowerState.SWITCH_ON_DISABLED

    def fail(self) -> None:
        """Enter the fault; the power stage is off at once."""
        self.state = PowerState.FAULT

    def _next(self, word: int) -> PowerState:
        if not word & _ENABLE_VOLTAGE or not word & _NO_QUICK_STOP:
            return PowerState.SWITCH_ON_DISABLED
        if not word & _SWITCH_ON:
            return PowerState.READY
        if self.state is PowerState.SWITCH_ON_DISABLED:
            return self.state
        if self.state is PowerState.READY or not word & _ENABLE:
            return PowerState.SWITCHED_ON
        return PowerState.ENABLED
