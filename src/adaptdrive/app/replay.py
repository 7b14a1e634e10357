"""`adaptdrive replay`: the controller again, on recorded measurements."""

from __future__ import annotations

from pathlib import Path


def replay(session: Path) -> int:
    """Not yet.

    Args:
        session: Session.
    """
    raise NotImplementedError(session)
