"""Settings of the runtime of one drive."""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.runtime.loop_interface import FastLoopSettings
from adaptdrive.runtime.machine_limits import MachineLimits


@dataclass(frozen=True, slots=True)
class DaemonSettings:
    """Settings of the runtime.

    Attributes:
        machine: Operator's limits.
        pole: Closed-loop pole at start.
        fast: The fast loop.
        report_s: Time between two drive reports.
        late_us: Lateness from which a tick is reported as an event.
        spin_s: Busy wait before a frame of the drive is due, and before a deadline of the timer.
        rehearse_s: How long before a frame of the drive is due a tick is rehearsed, 0 for never.
        collect_ticks: Ticks between two collections of garbage, 0 to leave that to Python.
        refused_share: Share of refused frames that trips the drive, 0 for none.
    """

    machine: MachineLimits
    pole: float
    fast: FastLoopSettings
    report_s: float
    late_us: float = math.inf
    spin_s: float = 0.0
    rehearse_s: float = 0.0
    collect_ticks: int = 0
    refused_share: float = 0.0
