"""Reading a configuration file, with every flaw named by its place."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from adaptdrive.config.root import Configuration
from adaptdrive.errors import ConfigurationError, Flaw


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
    place = ".".join(str(part) for part in error["loc"]) or "configuration"
    message = error["msg"].removeprefix("Value error, ")
    value = error["input"]
    if isinstance(value, str | int | float | bool) and repr(value) not in message:
        message = f"{message} (it is {value!r})"
    return Flaw(place, message)


def _anchored(configuration: Configuration, folder: Path) -> Configuration:
    database = folder / configuration.bus.database
    bus = configuration.bus.model_copy(update={"database": database})
    return configuration.model_copy(update={"bus": bus})
