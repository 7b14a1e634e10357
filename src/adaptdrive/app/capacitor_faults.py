"""Highest v_bst that a report which fails can lead to, as `adaptdrive check` states it."""

from __future__ import annotations

import math
from typing import Final

from adaptdrive.control.signals import Command
from adaptdrive.devices.port import Reading
from adaptdrive.runtime.capacitor import CapacitorBalance, CapacitorLimits

_FOLLOWED_TICKS: Final = 240
"""Half cycles after which every report that fails has tripped."""


def highest_voltages(
    limits: CapacitorLimits, reference_V: float, load_W: float, tick_s: float
) -> tuple[float, float]:
    """Return the highest v_bst, in V, that a silent and a frozen report can lead to.

    Either begins at the highest V_c with the largest k on its way that is allowed there, and the
    largest k is asked for from then on. The load stops as the report does. A report that is frozen
    at rest is asked when the energy that it does not show could have led to the limit.

    Args:
        limits: The capacitor.
        reference_V: Highest V_c.
        load_W: Power of the load, which a silent drive seems to take further on.
        tick_s: Half a line cycle.
    """
    silent_V = _highest_V(limits, reference_V, (load_W, load_W), (0.0, tick_s))
    frozen_V = _highest_V(limits, reference_V, (load_W, 0.0), (tick_s, tick_s))
    return silent_V, max(frozen_V, limits.highest_V)


def _highest_V(
    limits: CapacitorLimits,
    reference_V: float,
    load_W: tuple[float, float],
    steps_s: tuple[float, float],
) -> float:
    """Return the highest true v_bst of a drive on a line of 1 V, for which k is a power in W.

    Args:
        limits: The capacitor.
        reference_V: v_bst in all its reports.
        load_W: Reported power of the load before and after it stops.
        steps_s: Time from a report of v_bst to the next after that, and length of a tick.
    """
    balance, (step_s, tick_s) = CapacitorBalance(limits), steps_s
    asked = Command(limits.largest_W, reference_V, bridge=True)
    coming_W, squared_V2, cause = 0.0, reference_V**2, None
    for tick in range(-1, _FOLLOWED_TICKS):
        time_s, power_W = tick * (tick_s if tick < 0 else step_s), load_W[tick >= 0]
        reading = Reading(time_s, time_s, None, reference_V, 1.0, power_W, 0.0, 0, bridge=True)
        cause = cause or balance.find_cause(reading, 1, tick_s, running=True)
        squared_V2 += 2.0 * tick_s / limits.capacitance_F * coming_W
        coming_W = 0.0 if cause else balance.bound(asked).current_scale_S
        balance.sent(coming_W)
    return math.sqrt(squared_V2)
