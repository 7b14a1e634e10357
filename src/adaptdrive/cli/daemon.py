"""Commands that build a part of the daemon; each imports what it needs only."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def probe(
    config: Path,
    /,
    *,
    safe_command: bool = False,
    as_json: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> int:
    """Show decoded measurements and refused frames as they come from the bus; command nothing.

    Args:
        config: Configuration file.
        safe_command: Send the safe command, k = 0 and bridge off, and show the status of the drive.
        as_json: Print one JSON object a line, for programs.

    Returns:
        Exit status.
    """
    from adaptdrive.app.probe import probe as probe_drive  # noqa: PLC0415 - see above

    return probe_drive(config, safe_command=safe_command, as_json=as_json)


def replay(
    session: str | None = None,
    /,
    *,
    settings: Annotated[tuple[str, ...], Parameter(name="--set", negative=())] = (),
    json: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Run the controller again on the measurements of a recorded session.

    Args:
        session: Folder of the session, or its name below the sessions of this machine; the last one
            when left out.
        settings: Setting to change, KEY=VALUE, such as estimator.forgetting=0.95; may be repeated.
        json: Print JSON, for programs.

    Returns:
        0 when every command is bit-equal.
    """
    from adaptdrive.app.replay import replay as replay_session  # noqa: PLC0415 - see above

    return replay_session(session, settings, as_json=json)
