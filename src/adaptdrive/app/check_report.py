"""Report of `adaptdrive check --json` on a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from adaptdrive.app.advice import advice
from adaptdrive.app.settings import daemon_settings
from adaptdrive.app.time_limits import time_limits
from adaptdrive.config import Configuration
from adaptdrive.errors import ConfigurationError, escaped

Report = dict[str, Any]


def sound_report(configuration: Configuration, source: Path) -> Report:
    """Return the report of a configuration that can be used; a limit of 0 s is none.

    Args:
        configuration: The configuration.
        source: Its file.
    """
    load, machine = configuration.load, daemon_settings(configuration).machine
    return {
        "config": escaped(str(source)),
        "valid": True,
        "flaws": [],
        "warnings": [str(one) for one in advice(configuration)],
        "drive": configuration.drive.name,
        "output": {"name": load.output_name, "unit": load.output_unit},
        "reach": [machine.reach.low, machine.reach.high],
        "poles": [machine.pole_min, machine.pole_max],
        "time_limits": [
            {"of": what, "limit_s": limit_s, "keys": keys}
            for what, limit_s, keys in time_limits(configuration, source)
        ],
    }


def flawed_report(problem: ConfigurationError) -> Report:
    """Return the report of a configuration that cannot be used.

    Args:
        problem: Its flaws.
    """
    flaws = [{"place": one.place, "message": one.message} for one in problem.flaws]
    return {"config": escaped(str(problem.source)), "valid": False, "flaws": flaws}
