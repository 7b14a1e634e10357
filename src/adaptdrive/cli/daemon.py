"""Commands that build the daemon, or part of it, in this process."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from adaptdrive import app


def run(config: Path, /) -> int:
    """Run the daemon for one drive until it is told to stop.

    Args:
        config: Configuration file.

    Returns:
        Exit status.
    """
    return app.run(config)


def probe(config: Path, /) -> int:
    """Show decoded measurements as they come from the bus; command nothing.

    Args:
        config: Configuration file.

    Returns:
        Exit status.
    """
    return app.probe(config)


def replay(
    session: str,
    /,
    *,
    settings: Annotated[tuple[str, ...], Parameter(name="--set", negative=())] = (),
) -> int:
    """Run the controller again on the measurements of a recorded session.

    Args:
        session: Folder of the session, or its name below the sessions of this machine.
        settings: Ask "what if": KEY=VALUE, such as estimator.forgetting=0.95; may be repeated.

    Returns:
        0 when every command is bit-equal.
    """
    return app.replay(session, settings)
