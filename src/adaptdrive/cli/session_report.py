"""The report of the last session of a drive, for the panel at a desk."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory


def last_report(drive: str) -> bytes:
    """Draw the last session of a drive, the running one as far as it is; return its HTML page.

    Args:
        drive: Name of the drive.

    Raises:
        AdaptdriveError: There is none, or it cannot be read.
        OSError: As above.
    """
    from adaptdrive.analysis.plot import plot  # noqa: PLC0415 - it is large

    with TemporaryDirectory() as folder:
        _, report = plot(_last_session(drive), into=Path(folder))
        return report.read_bytes()


def _last_session(drive: str) -> Path:
    from adaptdrive.errors import RecordingError  # noqa: PLC0415 - `--help` reads no recordings
    from adaptdrive.recording.session import (  # noqa: PLC0415
        NO_SESSION,
        read_info,
        session_directories,
        sessions_directory,
    )

    sessions = sessions_directory(None, os.environ)
    for path in reversed(list(session_directories(sessions))):
        if read_info(path).drive == drive:
            return path
    raise RecordingError(sessions, NO_SESSION)
