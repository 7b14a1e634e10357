"""The pace of the loop: a slower pole while the actuator cannot follow the one asked for.

A pole that needs more than the actuator has is not reached: the loop runs at its limits, where
neither the response nor the estimates are what they were designed to be. While the input is at a
limit for more than a share of the time, the pole in force moves towards 1; when that is over, it
returns to the pole asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

BUSY_SHARE = 0.30
CALM_SHARE = 0.15
SLOWEST = 0.97

_RATE = 1.0 / 120.0
_SLOWER = 0.005
_FASTER = 0.001


@dataclass(slots=True)
class Pace:
    """What is remembered of the actuator.

    Attributes:
        share: Slow mean of the share of periods at a limit.
        slack: How much slower than asked for the pole is.
    """

    share: float = 0.0
    slack: float = 0.0


def paced_pole(state: Pace, pole: float, saturated: bool) -> float:
    """The pole to design for in this period.

    Args:
        state: Overwritten.
        pole: Asked for.
        saturated: Whether the last input was at a limit or could not be followed.
    """
    state.share += _RATE * ((1.0 if saturated else 0.0) - state.share)
    if state.share > BUSY_SHARE:
        state.slack += _SLOWER
    elif state.share < CALM_SHARE:
        state.slack = max(0.0, state.slack - _FASTER)
    state.slack = min(state.slack, max(0.0, SLOWEST - pole))
    return pole + state.slack
