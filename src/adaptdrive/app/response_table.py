"""The lowest plausible output, as it follows from a whole configuration."""

from __future__ import annotations

from adaptdrive.runtime.response import ResponseLimits

_KEY = "interlocks.response_factor"


def response_table(limits: ResponseLimits | None) -> str:
    """Return the limits of an output that is too low as lines of text.

    Args:
        limits: The limits in force, None for none.
    """
    if limits is None:
        return _line("trips on a low output", "never", f"{_KEY} = 0")
    key = f"{_KEY}, in force: {limits.factor:g}"
    lines = [
        _line("trips at rest, largest input, below", _level(limits, 1.0), key),
        _line("trips at rest, half of it, below", _level(limits, 0.5), key),
    ]
    if not limits.by_power:
        slowest_s = limits.factor * sum(limits.lags_s)
        lines += [
            _line("this level rises with a lag of", f"{slowest_s:.4g} s", key),
            _line(
                "trips on a fall faster than a lag of", f"{limits.fastest_s:.4g} s", f"{_KEY} > 0"
            ),
        ]
    return "\n".join(lines)


def _level(limits: ResponseLimits, share: float) -> str:
    level = limits.at_rest(share * limits.input_max) - limits.margin
    return f"{level:.4g} {limits.unit}".rstrip()


def _line(what: str, value: str, key: str) -> str:
    return f"{what:36} {value:>18}  {key}"
