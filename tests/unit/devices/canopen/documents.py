"""The example of a CiA 402 drive, and variations of it and of its EDS."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanOpenBus
from adaptdrive.config.file import validate_configuration
from adaptdrive.devices.canopen.mapping import CanOpenMapping, map_drive
from adaptdrive.util.errors import ConfigurationError

EXAMPLES = Path(__file__).parents[4] / "deploy" / "examples"
EXAMPLE = EXAMPLES / "motor-cia402.toml"
EDS = EXAMPLES / "cia402.eds"


def parse(changes: dict[str, Any] | None = None) -> Configuration:
    """The example, changed by `section/key`; None takes a key away."""
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    for place, value in (changes or {}).items():
        *sections, key = place.split("/")
        table = tables
        for section in sections:
            table = table.setdefault(section, {})
        if value is None:
            table.pop(key, None)
        else:
            table[key] = value
    return validate_configuration(tables, EXAMPLE)


def bus_of(configuration: Configuration) -> CanOpenBus:
    assert isinstance(configuration.bus, CanOpenBus)
    return configuration.bus


IN_MEMORY = {"bus/interface": "virtual", "bus/channel": "cia402"}
MEMORY = bus_of(parse(IN_MEMORY))
"""`[bus]` of the example in this process."""


def plan(changes: dict[str, Any] | None = None) -> CanOpenMapping:
    configuration = parse(changes)
    return map_drive(bus_of(configuration), configuration.signals, "bench.toml")


def flaws(changes: dict[str, Any] | None = None) -> dict[str, str]:
    """Message by place of every flaw of the example with changes."""
    try:
        plan(changes)
    except ConfigurationError as error:
        return {flaw.place: flaw.message for flaw in error.flaws}
    return {}


def other_eds(folder: Path, *changes: tuple[str, str]) -> Path:
    """The EDS of the example with some text replaced."""
    text = EDS.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "other.eds"
    path.write_text(text, encoding="utf-8")
    return path


def without(index: str) -> tuple[str, str]:
    """The change that takes an object out of the EDS, for a parser that goes by section names."""
    return f"[{index}", f"[gone {index}"
