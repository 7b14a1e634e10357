"""Commands that read a configuration and nothing else."""

import json
import sys
from contextlib import suppress
from pathlib import Path

from adaptdrive.cli.options import Json, print_json
from adaptdrive.cli.standard_files import UNUSABLE
from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanLink
from adaptdrive.config.file import find_flaws, read_text
from adaptdrive.util.errors import ConfigurationError


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
    from adaptdrive.app.check_report import tables  # noqa: PLC0415 - `schema` needs no bus
    from adaptdrive.app.examine import examine_text  # noqa: PLC0415
    from adaptdrive.app.starter import examples  # noqa: PLC0415
    from adaptdrive.devices.can.bus import missing_here  # noqa: PLC0415

    text = read_text(config)
    left = [f"{key} = {value}" for key, value in examples(text)]
    if left:
        remedy = "adapt each, then delete `example:` from its comment"
        _warn(config, f"values of the example: {', '.join(left)}; {remedy}")
    _advise(config, text)
    configuration = examine_text(text, config)
    if isinstance(configuration.bus, CanLink) and (problem := missing_here(configuration.bus)):
        print(f"adaptdrive: {config}: not on this machine: {problem}", file=sys.stderr)
    if configuration.signals.bridge is None and not configuration.bus.has_bridge_words:
        print(f"{config}: signals.bridge is missing: the drive cannot confirm that it has stopped")
    print(tables(configuration, config))
    unfinished = "is not configured yet: values of the example are left"
    end = unfinished if left else "is configured correctly"
    print(f"{config}: drive {configuration.drive.name} {end}")
    return 0


def _warn(config: Path, text: object) -> None:
    print(f"adaptdrive: {config}: warning: {text}", file=sys.stderr)


def _advise(config: Path, text: str) -> None:
    """Print the warnings, also where values that contradict each other are refused after them."""
    from adaptdrive.app.advice import advice  # noqa: PLC0415

    findings = find_flaws(text, config)
    if not findings.flaws:
        with suppress(ConfigurationError):  # of a DBC, EDS or register map: refused later
            for one in advice(findings.configuration):
                _warn(config, one)


def _check_for_programs(config: Path) -> int:
    from adaptdrive.app.check_report import flawed_report, sound_report  # noqa: PLC0415
    from adaptdrive.app.examine import load_examined  # noqa: PLC0415

    try:
        report = sound_report(load_examined(config), config)
    except ConfigurationError as problem:
        report = flawed_report(problem)
    print_json(report)
    return 0 if report["valid"] else UNUSABLE


def schema() -> int:
    """Print the JSON Schema of the configuration, for editors."""
    print(json.dumps(Configuration.model_json_schema(), indent=2, ensure_ascii=False))
    return 0
