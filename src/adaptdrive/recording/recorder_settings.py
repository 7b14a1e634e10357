"""Settings of the recorder: folders and intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from adaptdrive.recording.log import LARGEST_BACKLOG_BYTES
from adaptdrive.recording.records import Header


@dataclass(frozen=True, slots=True)
class Place:
    """Folders of the recorder.

    Attributes:
        log: Folder of the log.
        sessions: Folder of all sessions, None where none is recorded.
    """

    log: Path
    sessions: Path | None

    def seen_in(self, header: Header) -> Header:
        """Return facts with the folders, each seen from the other: both may be moved together."""
        if self.sessions is None:
            return header
        try:
            seen = _seen_from(self.sessions, self.log)
            seen.encode()
        except UnicodeEncodeError:
            seen = ""  # then a reader has to wait for the archiver
        info = msgspec.structs.replace(header.info, log=seen)
        sessions = _seen_from(self.log.parent, self.sessions)
        return msgspec.structs.replace(header, info=info, sessions=sessions)


@dataclass(frozen=True, slots=True)
class RecordingPace:
    """Intervals and time-outs of the recorder's writes.

    Attributes:
        flush_s: Longest time that ticks stay in the control process.
        backlog_bytes: Bytes of rows that may wait to be written; then the oldest are dropped.
        close_s: Longest time that the end of the recording takes, in two parts: the log, and the
            archiver.
        trip_s: Time after a trip that belongs to its record.
        keep_s: Longest time that an event waits for its record before it is published.
        start_thread: What a thread that writes does first.
    """

    flush_s: float = 0.25
    backlog_bytes: int = LARGEST_BACKLOG_BYTES
    close_s: float = 8.0
    trip_s: float = 10.0
    keep_s: float = 0.2
    start_thread: Callable[[], None] = lambda: None


DEFAULT_PACE = RecordingPace()


def _seen_from(folder: Path, other: Path) -> str:
    """Return the path of a folder from another one, which is its own where they are far apart."""
    if other.parent == folder:
        return other.name
    return f"../{other.name}" if other.parent == folder.parent else str(other)
