"""`adaptdrive replay`: the controller again, on recorded measurements."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from adaptdrive.app.settings import build_load, controller_settings
from adaptdrive.control.controller import Controller
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.replay import replay as run_again
from adaptdrive.recording.session import find_session, sessions_directory
from adaptdrive.recording.what_if import reconfigured


def replay(name: str, settings: Sequence[str] = ()) -> int:
    """Run the controller again and print what differs from the record.

    Args:
        name: Directory of a session, or its name below the sessions of this machine.
        settings: `KEY=VALUE` pairs that replace keys of the recorded configuration.

    Returns:
        0 when every command is bit-equal, or when settings were given, so that differences are
        the answer; else 1.

    Raises:
        AdaptdriveError: There is no such session, or a setting is not valid.
    """
    path = find_session(name, sessions_directory(None, os.environ))
    session = read_session(path)
    configuration = reconfigured(session.config_text, path / "config.toml", settings)
    load, prior = build_load(configuration), session.info.prior
    if prior is not None and len(prior) != len(load.names):
        prior = None  # the settings ask for another kind of load
    controller = Controller(controller_settings(configuration), load, prior)
    report = run_again(session, controller)
    sys.stdout.write(f"{report}\n")
    return 0 if report.exact or settings else 1
