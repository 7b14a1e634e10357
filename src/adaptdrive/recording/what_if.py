"""Replay of a recorded configuration with some of its keys changed."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from adaptdrive.config import Configuration
from adaptdrive.config.file import validate_configuration
from adaptdrive.errors import ConfigurationError, Flaw


def reconfigured(text: str, source: Path, settings: Sequence[str]) -> Configuration:
    """Validate a configuration after setting keys such as `estimator.forgetting=0.95` in it.

    Args:
        text: The configuration, as TOML.
        source: Where it came from.
        settings: `KEY=VALUE`; the value as in TOML, but a string needs no quotes.

    Returns:
        The configuration, whole and consistent.

    Raises:
        ConfigurationError: A setting or its outcome is not valid; the key is named.
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise ConfigurationError(source, [Flaw("TOML", str(problem))]) from problem
    flaws = [flaw for setting in settings if (flaw := _set(tables, setting))]
    if flaws:
        raise ConfigurationError(source, flaws)
    return validate_configuration(tables, source)


def _set(tables: dict[str, Any], setting: str) -> Flaw | None:
    """Set one key in place; tables on the way are made. The flaw that prevents it, if any."""
    key, equals, value = setting.partition("=")
    path = [part.strip() for part in key.split(".")]
    if not equals or not all(path):
        return Flaw(setting, "is not KEY=VALUE, such as estimator.forgetting=0.95")
    table: Any = tables
    for depth, part in enumerate(path[:-1], 1):
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            return Flaw(key.strip(), f"{'.'.join(path[:depth])} is a value, not a table")
    table[path[-1]] = _value(value.strip())
    return None


def _value(text: str) -> Any:  # noqa: ANN401  whatever TOML can say
    try:
        tables = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return tables["value"] if len(tables) == 1 else text
