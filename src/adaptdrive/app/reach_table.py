"""The set-points and poles that the nominal model allows, as `check` shows them."""

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


def pole_line(configuration: Configuration) -> str:
    """Return the poles that an operator may ask for as a line of text.

    Args:
        configuration: A valid configuration.
    """
    limits = daemon_settings(configuration).machine
    poles = f"{limits.pole_min:g}…{limits.pole_max:g}"
    return _line("poles an operator may ask for", poles, "load.pole_min, load.pole_max, load.model")


def _line(what: str, value: str, key: str) -> str:
    return f"{what:36} {value:>18}  {key}"
