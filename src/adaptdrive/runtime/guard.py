"""The last look at a command before the wire: finite, in range, not jumping."""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control.signals import SAFE_COMMAND, Command


@dataclass(frozen=True, slots=True)
class CommandLimits:
    """What may be sent.

    Attributes:
        current_scale_min_S: Lowest k.
        current_scale_max_S: Highest k.
        current_scale_slew_S: Largest change of k from one tick to the next.
        boost_reference_max_V: Highest V_c; the lowest is 0, the safe command's.
    """

    current_scale_min_S: float
    current_scale_max_S: float
    current_scale_slew_S: float
    boost_reference_max_V: float


class Guard:
    """Holds every command to its limits and counts what it had to change.

    Attributes:
        corrected: Commands that were limited.
        refused: Commands that were replaced by the safe one because a value was not finite.
    """

    def __init__(self, limits: CommandLimits) -> None:
        self._limits = limits
        self._last_scale_S = 0.0
        self.corrected = 0
        self.refused = 0

    def check(self, command: Command) -> Command:
        """The command to send: the given one wherever it is within limits."""
        if not (
            math.isfinite(command.current_scale_S) and math.isfinite(command.boost_reference_V)
        ):
            self.refused += 1
            command = SAFE_COMMAND
        if command == SAFE_COMMAND:
            self._last_scale_S = 0.0
            return SAFE_COMMAND
        checked = self._limited(command)
        if checked != command:
            self.corrected += 1
        self._last_scale_S = checked.current_scale_S
        return checked

    def _limited(self, command: Command) -> Command:
        limits, last = self._limits, self._last_scale_S
        low = max(limits.current_scale_min_S, last - limits.current_scale_slew_S)
        high = min(limits.current_scale_max_S, last + limits.current_scale_slew_S)
        return Command(
            current_scale_S=min(max(command.current_scale_S, low), high),
            boost_reference_V=min(
                max(command.boost_reference_V, 0.0), limits.boost_reference_max_V
            ),
            bridge=command.bridge,
        )
