"""Commands that read a configuration and nothing else."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import Parameter

from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanLink
from adaptdrive.config.file import read_text
from adaptdrive.errors import ConfigurationError

Json = Annotated[bool, Parameter(name="--json", negative=())]
FLAWED = 2


def check(config: Path, /, *, as_json: Json = False) -> int:
    """Validate a configuration; list every error with its place.

    The DBC or register map and the capacity of each link are checked too; no bus is opened. Values
    that can be used, but are probably not meant, give a warning on standard error.

    Args:
        config: Configuration file.
        as_json: Print JSON, for programs.

    Returns:
        0 when it can be used; otherwise `ConfigurationError` lists what is wrong.
    """
    if as_json:
        return _check_for_programs(config)
    from adaptdrive.app.advice import advice  # noqa: PLC0415 - `schema` needs no bus
    from adaptdrive.app.examine import load_examined  # noqa: PLC0415
    from adaptdrive.app.example_values import examples  # noqa: PLC0415
    from adaptdrive.app.interlocks import response_limits  # noqa: PLC0415
    from adaptdrive.app.reach_table import pole_line, reach_table, response_table  # noqa: PLC0415
    from adaptdrive.app.settings import tick_s  # noqa: PLC0415
    from adaptdrive.app.time_limits import limits_table, time_limits  # noqa: PLC0415
    from adaptdrive.hardware.link.bus import missing_here  # noqa: PLC0415

    configuration = load_examined(config)
    if left := [f"{key} = {value}" for key, value in examples(read_text(config))]:
        print(
            f"adaptdrive: {config}: warning: values of the example: {', '.join(left)}; adapt each, "
            "then delete `example:` from its comment",
            file=sys.stderr,
        )
    for one in advice(configuration):
        print(f"adaptdrive: {config}: warning: {one}", file=sys.stderr)
    if isinstance(configuration.bus, CanLink) and (problem := missing_here(configuration.bus)):
        print(f"adaptdrive: {config}: not on this machine: {problem}", file=sys.stderr)
    if configuration.signals.bridge is None and not configuration.bus.has_bridge_words:
        print(f"{config}: signals.bridge is missing: the drive cannot confirm that it has stopped")
    print(limits_table(time_limits(configuration, config), tick_s(configuration)))
    print(reach_table(configuration))
    print(pole_line(configuration))
    print(response_table(response_limits(configuration)))
    print(f"{config}: drive {configuration.drive.name} is configured correctly")
    return 0


def _check_for_programs(config: Path) -> int:
    from adaptdrive.app.check_report import flawed_report, sound_report  # noqa: PLC0415
    from adaptdrive.app.examine import load_examined  # noqa: PLC0415

    try:
        report = sound_report(load_examined(config), config)
    except ConfigurationError as problem:
        report = flawed_report(problem)
    print(msgspec.json.format(msgspec.json.encode(report)).decode())
    return 0 if report["valid"] else FLAWED


def schema() -> int:
    """Print the JSON Schema of the configuration, for editors."""
    print(json.dumps(Configuration.model_json_schema(), indent=2, ensure_ascii=False))
    return 0
