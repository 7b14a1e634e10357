"""Time limits of each quantity, as they follow from a whole configuration."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from adaptdrive.app.ports import bus_kind
from adaptdrive.config import Configuration
from adaptdrive.hardware.bus_kind import Row
from adaptdrive.runtime.refused_share import WINDOW_S

_WHOLE_TICKS = 1e4
"""Number of half cycles from which on all digits are printed."""


def time_limits(configuration: Configuration, source: Path | str) -> list[Row]:
    """Return the limits of time that are in force, 0 for none.

    Args:
        configuration: The drive.
        source: The configuration's file.
    """
    interlocks, supervisor = configuration.interlocks, configuration.supervisor
    return [
        *bus_kind(configuration.bus.type, source).time_limits(configuration, source),
        *_sensor_rows(configuration),
        ("daemon not running", interlocks.stale_s, "interlocks.stale_s"),
        ("starting", interlocks.precharge_timeout_s, "interlocks.precharge_timeout_s"),
        (
            "share of refused frames",
            WINDOW_S if interlocks.refused_share else 0.0,
            "interlocks.refused_share",
        ),
        ("output standing still", interlocks.stuck_s, "interlocks.stuck_s"),
        ("input at its limit, no response", supervisor.response_s, "supervisor.response_s"),
    ]


def limits_table(rows: list[Row], tick_s: float) -> str:
    """Return the limits as lines of text, in milliseconds and half cycles.

    Args:
        rows: The limits.
        tick_s: Half a line cycle.
    """
    head = f"{'trips after':36} {'ms':>9} {'ticks':>8}  by"
    return "\n".join([head, *(_line(*row, tick_s) for row in rows)])


def _line(what: str, limit_s: float, keys: str, tick_s: float) -> str:
    if not limit_s:
        return f"{what:36} {'never':>9} {'':>8}  {keys} = 0"
    ticks = limit_s / tick_s
    number = f"{ticks:.4g}" if ticks < _WHOLE_TICKS else f"{ticks:.0f}"
    return f"{what:36} {limit_s * 1e3:9.9g} {number:>8}  {keys}"


def _sensor_rows(configuration: Configuration) -> Iterator[Row]:
    for bus in configuration.sensor_bus:
        keys = "sensor_bus.cycle_s" if bus.stale_s is None else "sensor_bus.stale_s"
        for name in bus.signals:
            yield f"stale {bus.name}.{name}", bus.oldest_s, keys
