"""Notices that a drive may have come on and stopped by itself while nothing was heard of it."""

from __future__ import annotations

import math

from adaptdrive.config.timing import Timing
from adaptdrive.hardware.canopen.profile import ENABLE_OPERATION, DriveControl, DriveState


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
