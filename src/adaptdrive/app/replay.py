"""`adaptdrive replay`: the controller again, on recorded measurements."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import msgspec

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.load import Load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.errors import ConfigurationError
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.replay import replay as run_again
from adaptdrive.recording.replay_report import ReplayReport
from adaptdrive.recording.session import SessionInfo, find_session, sessions_directory
from adaptdrive.recording.what_if import reconfigured


def replay(name: str | None, settings: Sequence[str] = (), *, as_json: bool = False) -> int:
    """Run the controller again and print what differs from the record.

    Args:
        name: Directory of a session, or its name below the sessions of this machine; None for
            the last one.
        settings: `KEY=VALUE` pairs that replace keys of the recorded configuration.
        as_json: Print JSON, for programs.

    Returns:
        0 when every command is bit-equal, or when settings were given, so that differences are
        the answer; else 1.

    Raises:
        AdaptdriveError: There is no such session, or a setting is not valid.
    """
    path = find_session(name, sessions_directory(None, os.environ))
    session = read_session(path)
    configuration = reconfigured(session.config_text, path / "config.toml", settings)
    report = run_again(session, controller_at_start(session.info, configuration))
    if session.damage:
        sys.stderr.write(f"adaptdrive: {session.damage}\n")
    for setting in settings:
        if not _acts(session.config_text, path / "config.toml", setting):
            sys.stderr.write(f"adaptdrive: {setting}: {_WITHOUT_EFFECT}\n")
    sys.stdout.write(f"{_as_json(report) if as_json else report}\n")
    return 0 if report.exact or settings else 1


def controller_at_start(info: SessionInfo, configuration: Configuration) -> Controller:
    """Return a controller that begins with what the recorded one had learnt before.

    Args:
        info: Of the session.
        configuration: Of the controller, which may ask for another kind of load.
    """
    load, prior = build_load(configuration), info.prior
    if prior is not None and len(prior) != len(load.names):
        prior = None
    return Controller(controller_settings(configuration), load, prior, info.resolution)


def _as_json(report: ReplayReport) -> str:
    facts = {"bit_equal": report.exact, **asdict(report)}
    return msgspec.json.format(msgspec.json.encode(facts), indent=2).decode()


_WITHOUT_EFFECT = (
    "has no effect on a replay, which takes measurements and orders (set-point, pole, mode, stage) "
    "from the record"
)


def _acts(text: str, source: Path, setting: str) -> bool:
    """Return whether a setting changes anything of the controller that is run again."""
    try:
        changed = reconfigured(text, source, (setting,))
    except ConfigurationError:  # it needs another setting, too
        return True
    recorded = reconfigured(text, source, ())
    return _controlled(changed) != _controlled(recorded)


def _controlled(configuration: Configuration) -> tuple[ControllerSettings, Load]:
    return controller_settings(configuration), build_load(configuration)
