"""The set-points that V_c can hold by the nominal model, as `check` shows them."""

from __future__ import annotations

from adaptdrive.app.settings import daemon_settings
from adaptdrive.config import Configuration


def reach_table(configuration: Configuration) -> str:
    """Return the reachable set-points as lines of text.

    Args:
        configuration: A valid configuration.
    """
    load, limits = configuration.load, daemon_settings(configuration).machine
    reach, unit = limits.reach, load.output_unit
    if not reach.is_known:
        return _line("set-points held by V_c", "found while running", "the EMF is not configured")
    low, high = max(reach.low, load.reference_min), min(reach.high, load.reference_max)
    lines = [_line("set-points held by V_c", f"{low:g}…{high:g} {unit}".rstrip(), "load.model")]
    if load.reference_min < reach.low:
        lines.append(
            _line("set-points below this range", "refused", "load.reference_min; 0 coasts")
        )
    if load.reference_max > reach.high:
        lines.append(_line("set-points above this range", "refused", "load.reference_max"))
    return "\n".join(lines)


def _line(what: str, value: str, key: str) -> str:
    return f"{what:36} {value:>18}  {key}"
