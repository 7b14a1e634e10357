"""Values of a first configuration that are those of the example until somebody changes them.

Each has `example:` in its comment. `init` asks for them; `check` names those that are left.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

QUESTIONS = {
    "drive.line_frequency_Hz": "frequency of the line in Hz",
    "drive.line_voltage_V": "voltage of the line in V, rms",
    "drive.limits.boost_reference_min_V": "lowest voltage of the dc bus in V",
    "drive.limits.boost_reference_max_V": "highest voltage of the dc bus in V",
    "load.reference_min": "lowest set-point in the unit of the output",
    "load.reference_max": "highest set-point",
    "interlocks.output_max": "output above which the drive trips",
    "mqtt.host": "broker",
}
"""Questions of `init` by key, in the order in which it asks."""

_LIKELY = {"mqtt.host"}
"""Keys whose value in the example is that of many sites: they are not marked."""

_LINE = re.compile(r"(?P<key>\w+) = (?P<value>[^#\n]*?)(?P<gap>\s*)(# (?P<comment>.*))?$")
_MARK = "example:"


def examples(text: str) -> Iterator[tuple[str, str]]:
    """Yield key and value of each value of the example that is left.

    Args:
        text: A configuration.
    """
    for key, line in _lines(text):
        found = _LINE.match(line)
        if found is not None and (found["comment"] or "").startswith(_MARK):
            yield key, found["value"]


def asked(text: str) -> dict[str, str]:
    """Return the values that `init` asks for, by key, as they stand in a configuration."""
    found = ((key, _LINE.match(line)) for key, line in _lines(text) if key in QUESTIONS)
    return {key: match["value"] for key, match in found if match is not None}


def marked(text: str) -> str:
    """Return a configuration whose values are marked as those of the example."""
    return answered(text, dict.fromkeys(QUESTIONS.keys() - _LIKELY, ""))


def answered(text: str, answers: dict[str, str]) -> str:
    """Return a configuration with values by key, which are marked no longer.

    Args:
        text: The configuration.
        answers: Values, as TOML; an empty one marks the value that is there.
    """
    return "".join(
        f"{_line(line, answers[key]) if key in answers else line}\n" for key, line in _lines(text)
    )


def _line(line: str, value: str) -> str:
    """Return a line with another value, or marked where there is none."""
    found = _LINE.match(line)
    if found is None:
        return line
    if value:
        return f"{found['key']} = {value}"
    comment = found["comment"] or "adapt"
    return f"{found['key']} = {found['value']}{found['gap'] or '  '}# {_MARK} {comment}"


def _lines(text: str) -> Iterator[tuple[str, str]]:
    """Yield each line with the key that it sets, empty for none."""
    section = ""
    for line in text.splitlines():
        if line.startswith("["):
            section = line.strip("[] ")
        found = _LINE.match(line)
        yield (f"{section}.{found['key']}" if found else ""), line
