"""Does the cadence of a polled drive fit what surrounds it?"""

from __future__ import annotations

from collections.abc import Iterator

from adaptdrive.config.load import LoadSection
from adaptdrive.config.modbus import ModbusBus
from adaptdrive.config.services import InterlocksSection
from adaptdrive.errors import Flaw

STALE_POLLS = 1.5
"""Poll cycles that a measurement must be allowed to age: it is one old when the next one comes."""


def poll_flaws(
    bus: ModbusBus, load: LoadSection, interlocks: InterlocksSection, half_cycle_s: float
) -> Iterator[Flaw]:
    """Yield the contradictions to a poll cycle.

    Args:
        bus: `[bus]`.
        load: `[load]`.
        interlocks: `[interlocks]`.
        half_cycle_s: Half a line cycle.
    """
    poll_s = bus.poll_ticks * half_cycle_s
    cycle = f"one poll of bus.poll_ticks = {bus.poll_ticks} half cycles ({poll_s * 1e3:.4g} ms)"
    if bus.timeout_s >= poll_s:
        yield Flaw("bus.timeout_s", f"{bus.timeout_s} must be below {cycle}")
    if interlocks.stale_s < STALE_POLLS * poll_s:
        lowest = f"{STALE_POLLS * poll_s:.4g} s, {STALE_POLLS} times {cycle}"
        yield Flaw("interlocks.stale_s", f"{interlocks.stale_s} must be at least {lowest}")
    if load.latency_ticks % bus.poll_ticks:
        effect = "a decision reaches the drive with a poll"
        yield Flaw(
            "load.latency_ticks", f"{load.latency_ticks} must be a multiple of {cycle}: {effect}"
        )
    ticks = round(load.period_s / half_cycle_s)
    if ticks % bus.poll_ticks:
        yield Flaw("load.period_s", f"{load.period_s} must be a whole multiple of {cycle}")
