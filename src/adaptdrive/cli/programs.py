"""Slopes and programs as people write them: `2/s`, `20/h`, and a TOML file."""

from __future__ import annotations

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

_NO_SLOPE = '"{}" is no slope such as 2/s, 1.5/min or 20/h.'
_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def per_second(text: str) -> float:
    """Return a slope per second from text such as `2/s`, `1.5/min` or `20/h`.

    Raises:
        ValueError: It is none.
    """
    number, _, unit = text.partition("/")
    try:
        slope = float(number) / _SECONDS[unit.strip() or "s"]
    except (ValueError, LookupError):
        slope = math.nan
    if not 0.0 < slope < math.inf:
        raise ValueError(_NO_SLOPE.format(text))
    return slope


def _read_slope(_: object, tokens: Sequence[cyclopts.Token]) -> Typed:
    """Return a slope per second, and the unit before the slash."""
    level, slash, time = tokens[0].value.rpartition("/")
    try:
        unit = typed(level).unit if slash else ""
        found = Typed(per_second(f"{level.rstrip().removesuffix(unit)}{slash}{time}"))
    except ValueError:
        raise ValueError(_NO_SLOPE.format(tokens[0].value)) from None
    found.unit = unit
    return found


Slope = Annotated[Typed, Parameter(converter=_read_slope)]

_STEP = re.compile(r"steps\[(\d+)\]")


def read_program(path: Path) -> dict[str, Any]:
    """Return the program of a TOML file as the daemon takes it; its name is that of the file.

    Raises:
        ConfigurationError: It cannot be read, or is no program; the step is named.
    """
    from adaptdrive.config.file import read_text  # noqa: PLC0415 - few commands need it

    try:
        found = {"name": path.stem, **tomllib.loads(read_text(path))}
        _convert_slopes(found.get("steps"))
        program: dict[str, Any] = msgspec.to_builtins(msgspec.convert(found, Program))
    except (ValueError, RecursionError) as problem:  # of TOML, or of the steps
        flaw, _, place = str(problem).partition(" - at `$.")
        named = _STEP.sub(lambda step: f"step {int(step[1]) + 1}", place.rstrip("`"))
        raise ConfigurationError.of(path, named or "program", flaw) from problem
    return program


def _convert_slopes(steps: object) -> None:
    """Bring slopes such as `20/h` to numbers per second."""
    for number, step in enumerate(steps if isinstance(steps, list) else ()):
        if isinstance(step, dict) and isinstance(step.get("slope"), str):
            try:
                step["slope"] = per_second(step["slope"])
            except ValueError as problem:
                raise ValueError(f"{problem} - at `$.steps[{number}].slope`") from problem
