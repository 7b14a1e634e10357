"""Reading a configuration file, with every flaw named by its place."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from adaptdrive.config.load import LOAD_TYPES
from adaptdrive.config.root import BUS_TYPES, Configuration
from adaptdrive.config.section import Section
from adaptdrive.errors import ConfigurationError, Flaw

_TYPES = {"load": LOAD_TYPES, "bus": BUS_TYPES, "sensor_bus": BUS_TYPES}
_BUS_PATHS = {"can": ("database",), "canopen": ("eds",), "modbus-rtu": ("device",)}
_MESSAGES = {"extra_forbidden": "Unknown key", "union_tag_not_found": "Field required"}


def load_configuration(path: Path) -> Configuration:
    """Read and validate one TOML file; relative paths in it are taken from its folder.

    Args:
        path: The file.

    Returns:
        The configuration, whole and consistent.

    Raises:
        ConfigurationError: The file cannot be read, or holds flaws; all of them are listed.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        raise ConfigurationError(path, [Flaw("file", str(problem))]) from problem
    return parse_configuration(text, path)


def parse_configuration(text: str, source: Path) -> Configuration:
    """Validate the text of a configuration that came from (or belongs beside) `source`.

    Raises:
        ConfigurationError: As for `load_configuration`.
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise ConfigurationError(source, [Flaw("TOML", str(problem))]) from problem
    return validate_configuration(tables, source)


def validate_configuration(tables: dict[str, Any], source: Path) -> Configuration:
    """Validate the tables of a configuration that came from (or belongs beside) `source`.

    Raises:
        ConfigurationError: As for `load_configuration`.
    """
    try:
        configuration = Configuration.model_validate(tables)
    except ValidationError as problem:
        raise ConfigurationError(source, _flaws(problem)) from problem
    return _anchored(configuration, source.parent)


def _flaws(problem: ValidationError) -> list[Flaw]:
    return [_flaw(dict(error)) for error in problem.errors(include_url=False)]


def _flaw(error: dict[str, Any]) -> Flaw:
    place = _place(error["loc"])
    message = _MESSAGES.get(error["type"], error["msg"]).removeprefix("Value error, ")
    if error["type"].startswith("union_tag"):
        place = f"{place}.type"
    value = error["input"]
    if isinstance(value, str | int | float | bool) and repr(value) not in message:
        message = f"{message} (it is {value!r})"
    return Flaw(place, message)


def _place(location: tuple[int | str, ...]) -> str:
    """The dotted key; pydantic counts a type of load or bus as a table of its own."""
    at = 2 if location[1:2] and isinstance(location[1], int) else 1  # of a list, or not
    if location[at : at + 1] and location[at] in _TYPES.get(str(location[0]), ()):
        location = (*location[:at], *location[at + 1 :])
    return ".".join(str(part) for part in location)


def _anchored(configuration: Configuration, folder: Path) -> Configuration:
    return configuration.model_copy(
        update={
            "bus": _placed_bus(configuration.bus, folder),
            "sensor_bus": [_placed_bus(bus, folder) for bus in configuration.sensor_bus],
            "mqtt": _placed(configuration.mqtt, folder, "ca_file", "password_file"),
            "recording": _placed(configuration.recording, folder, "directory"),
        }
    )


def _placed_bus(bus: Section, folder: Path) -> Section:
    return _placed(bus, folder, *_BUS_PATHS.get(getattr(bus, "type", ""), ()))


def _placed(section: Section, folder: Path, *keys: str) -> Section:
    paths = {key: getattr(section, key) for key in keys}
    placed = {key: folder / path for key, path in paths.items() if path is not None}
    return section.model_copy(update=placed)
