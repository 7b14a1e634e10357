"""The last look at a command before the wire: finite, in range, not jumping."""

import math

from adaptdrive.config.root import DriveSection
from adaptdrive.control.signals import SAFE_COMMAND, Command


class Guard:
    """Holds every command to its limits and counts what it had to change.

    Attributes:
        limited: Commands that were held to a limit.
    """

    def __init__(self, drive: DriveSection) -> None:
        self._limits, self._given = drive.limits, drive.given
        self._lowest_S = drive.current_scale_min_S
        self._last_scale_S = 0.0
        self.limited = 0

    def check(self, command: Command) -> Command:
        """Return the command to send: the given one wherever it is within limits.

        Raises:
            ValueError: A value is not finite.
        """
        scale_S, reference_V = command.current_scale_S, command.boost_reference_V
        if not (math.isfinite(scale_S) and math.isfinite(reference_V)):
            given = self._given
            raise ValueError(
                f"the controller gave k = {scale_S:g} S, {given.symbol} = "
                f"{given.text(reference_V, 'g')}, which is not finite; keep the session "
                "for a report, then reset"
            )
        if not (command.bridge or scale_S or reference_V):
            self._last_scale_S = 0.0
            return SAFE_COMMAND
        limits, last_S = self._limits, self._last_scale_S
        low_S = max(self._lowest_S, last_S - limits.current_scale_slew_S)
        high_S = min(limits.current_scale_max_S, last_S + limits.current_scale_slew_S)
        self._last_scale_S = min(max(scale_S, low_S), high_S)
        lowest_V = min(limits.boost_reference_min_V, 0.0)
        limited_V = min(max(reference_V, lowest_V), limits.boost_reference_max_V)
        if self._last_scale_S == scale_S and limited_V == reference_V:
            return command
        self.limited += 1
        return Command(self._last_scale_S, limited_V, command.bridge)
