"""`adaptdrive replay`: the controller again, on recorded measurements."""

import sys
from dataclasses import asdict
from pathlib import Path

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.cli.options import Json, Settings, print_json
from adaptdrive.cli.sessions import find
from adaptdrive.config import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.recording import reader
from adaptdrive.recording.replay import reconfigured
from adaptdrive.recording.replay import replay as run_again
from adaptdrive.recording.session import SessionInfo
from adaptdrive.util.errors import ConfigurationError


def replay(session: str | None = None, /, *, settings: Settings = (), as_json: Json = False) -> int:
    """Run the controller again on the measurements of a recorded session.

    Args:
        session: Folder of the session, or its name below the sessions of this machine; the last one
            when left out.
        settings: Setting to change, KEY=VALUE, such as estimator.forgetting=0.95; may be repeated.
        as_json: Print JSON, for programs.

    Returns:
        0 when every command is bit-equal, or when settings were given, so that differences are
        the answer; else 1.

    Raises:
        AdaptdriveError: There is no such session, or a setting is not valid.
    """
    path = find(session)
    record = reader.read_session(path)
    configuration = reconfigured(record.config_text, path / "config.toml", settings)
    report = run_again(record, controller_at_start(record.info, configuration))
    if record.damage:
        sys.stderr.write(f"adaptdrive: {record.damage}\n")
    for setting in settings:
        if not _acts(record.config_text, path / "config.toml", setting):
            sys.stderr.write(f"adaptdrive: {setting}: {_WITHOUT_EFFECT}\n")
    if as_json:
        print_json({"bit_equal": report.exact, **asdict(report)})
    else:
        print(report)
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
