"""Programs as people write them: a TOML or JSON file, with times such as `2 h` and slopes."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import cyclopts
import msgspec
from cyclopts import Parameter

from adaptdrive.cli.options import Typed, typed
from adaptdrive.runtime.requests import Program
from adaptdrive.util.errors import ConfigurationError

_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def per_second(text: str) -> float:
    """Return a slope per second from text such as `2/s`, `1.5/min` or `20/h`.

    Raises:
        ValueError: It is none.
    """
    number, slash, unit = text.partition("/")
    return _positive(number, text, "2/s, 1.5/min or 20/h") / _unit(unit, slash, text)


def seconds(text: str) -> float:
    """Return a time in s from text such as `2 h`, `90 min` or `30 s`.

    Raises:
        ValueError: It is none.
    """
    number, space, unit = text.strip().partition(" ")
    return _positive(number, text, "2 h, 90 min or 30 s") * _unit(unit, space, text)


def _positive(number: str, text: str, such_as: str) -> float:
    """Return the number of a text that has one, finite and above 0."""
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f'"{text}" is not a positive number with its unit, such as {such_as}.')
    return value


def _unit(unit: str, mark: str, text: str) -> float:
    """Return the seconds of a unit; one that is left out is the second."""
    name = unit.strip() if mark else "s"
    if name not in _SECONDS:
        raise ValueError(f'"{text}" has none of the units {", ".join(_SECONDS)}.')
    return _SECONDS[name]


def _read_slope(_: object, tokens: Sequence[cyclopts.Token]) -> Typed:
    """Return a slope per second, and the unit before the slash."""
    level, slash, time = tokens[0].value.rpartition("/")
    unit = typed(level).unit if slash else ""
    found = Typed(per_second(f"{level.rstrip().removesuffix(unit)}{slash}{time}"))
    found.unit = unit
    return found


Slope = Annotated[Typed, Parameter(converter=_read_slope)]


_STEP = re.compile(r"steps\[(\d+)\]")


def read_program(path: Path) -> dict[str, Any]:
    """Return the program of a file as the daemon takes it; its name is that of the file.

    Args:
        path: TOML, or JSON where its name ends in `.json`. `for` is a time with its unit, and
            `slope` may have one.

    Raises:
        ConfigurationError: It cannot be read, or is no program; the step is named.
    """
    from adaptdrive.config.file import read_text  # noqa: PLC0415 - few commands need it

    text = read_text(path)
    try:
        found = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except ValueError as problem:
        raise ConfigurationError.of(path, "program", str(problem)) from problem
    try:
        program = msgspec.convert(_in_si(found, path), Program)
    except msgspec.ValidationError as problem:
        flaw, _, place = str(problem).partition(" - at `$.")
        named = _STEP.sub(lambda step: f"step {int(step[1]) + 1}", place.rstrip("`"))
        raise ConfigurationError.of(path, named or "program", flaw) from problem
    content: dict[str, Any] = msgspec.to_builtins(program)
    return content


def _in_si(found: Any, path: Path) -> Any:  # noqa: ANN401 - whatever the file has
    """Return the contents of a file with its times in s and its slopes per second."""
    if not isinstance(found, dict) or not isinstance(found.get("steps"), list):
        return found
    steps = []
    for number, step in enumerate(found["steps"], 1):
        try:
            steps.append(_step_in_si(step) if isinstance(step, dict) else step)
        except ValueError as problem:
            raise ConfigurationError.of(path, f"step {number}", str(problem)) from problem
    return {"name": path.stem, **found, "steps": steps}


def _step_in_si(step: dict[str, Any]) -> dict[str, Any]:
    converted = dict(step)
    if isinstance(step.get("for"), str):
        converted["for_s"] = seconds(converted.pop("for"))
    if isinstance(step.get("slope"), str):
        converted["slope"] = per_second(step["slope"])
    return converted
