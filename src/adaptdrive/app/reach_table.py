"""Set-points, poles and the lowest plausible output by the nominal model, as `check` shows them."""

from __future__ import annotations

from adaptdrive.app.settings import daemon_settings
from adaptdrive.config import Configuration
from adaptdrive.runtime.response import ResponseLimits

_FACTOR = "interlocks.response_factor"


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


def response_table(limits: ResponseLimits | None) -> str:
    """Return the limits of an output that is too low as lines of text.

    Args:
        limits: The limits in force, None for none.
    """
    if limits is None:
        return _line("trips on a low output", "never", f"{_FACTOR} = 0")
    key = f"{_FACTOR}, in force: {limits.factor:g}"
    lines = [
        _line("trips at rest, largest input, below", _level(limits, 1.0), key),
        _line("trips at rest, half of it, below", _level(limits, 0.5), key),
    ]
    if not limits.by_power:
        slowest_s = limits.factor * sum(limits.lags_s)
        lines += [
            _line("this level rises with a lag of", f"{slowest_s:.4g} s", key),
            _line(
                "trips on a fall faster than a lag of",
                f"{limits.fastest_s:.4g} s",
                f"{_FACTOR} > 0",
            ),
        ]
    return "\n".join(lines)


def _level(limits: ResponseLimits, share: float) -> str:
    level = limits.at_rest(share * limits.input_max) - limits.margin
    return f"{level:.4g} {limits.unit}".rstrip()


def _line(what: str, value: str, key: str) -> str:
    return f"{what:36} {value:>18}  {key}"
