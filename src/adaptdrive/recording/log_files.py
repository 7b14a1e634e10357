"""Files of the log: names, records, and the state that they carry to the next run.

Replies are remembered for commands that come again, events until the broker has them, and of trips
and estimates the last one. The first record of a segment has all of it, so that a segment can be
removed once its rows are in the folder of their session.

A file is named by its running number, the start of its session and the segment of that session.
The daemon holds a lock on the file that it writes.
"""

import contextlib
import errno
import fcntl
import os
import re
import shutil
from collections import OrderedDict, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path

import msgspec

from adaptdrive.recording.records import LARGEST_BYTES, EventRow, Header, Kind, Record, read_frames
from adaptdrive.recording.session import Ending, SessionInfo, time_in_name
from adaptdrive.util.errors import NOT_JSON, RecordingError, reason_of
from adaptdrive.util.files import read_regular, require_regular

# State that the log carries from segment to segment: a fold over its records.

REPLIES = 1000
EVENTS = 10_000
TRIP = "trip"
"""Kind of the event of a trip."""


class Recalled(msgspec.Struct, frozen=True, omit_defaults=True):
    """State that earlier segments and runs have left.

    Attributes:
        replies: Id, age in seconds and contents of each reply, the oldest first.
        unsent: Events that the broker does not have.
        trip: Event of the last trip.
        learnt: Estimates for the next run; empty for none.
        number: Number of the last record.
        file: Number of the last file.
        flaws: What of it cannot be read, in words.
    """

    replies: tuple[tuple[str, float, bytes], ...] = ()
    unsent: tuple[EventRow, ...] = ()
    trip: EventRow | None = None
    learnt: bytes = b""
    number: int = 0
    file: int = 0
    flaws: tuple[str, ...] = ()


class Begin(msgspec.Struct, frozen=True):
    """First record of a segment.

    Attributes:
        header: The session that it belongs to.
        part: Segment of the session that its rows are in, from 1.
        left: What segments before it have left.
    """

    header: Header
    part: int
    left: Recalled = Recalled()


class LogMemory:
    """The fold.

    Attributes:
        number: Number of the last record.
    """

    def __init__(self, recalled: Recalled, now_s: float) -> None:
        """Begin with what an earlier run has left.

        Args:
            recalled: That.
            now_s: Present time, monotonic.
        """
        self._begin(recalled, now_s)
        self.number, self._time_s, self._wall_s = recalled.number, now_s, 0.0

    def _begin(self, left: Recalled, now_s: float) -> None:
        self._replies = OrderedDict(
            (identity, (now_s - age_s, body)) for identity, age_s, body in left.replies
        )
        self._unsent = deque(left.unsent, maxlen=EVENTS)
        self._trip, self._learnt = left.trip, left.learnt

    def take(self, record: Record) -> None:
        """Take a record; one that cannot be decoded has no effect.

        Args:
            record: The next one of the log.
        """
        self.number, self._time_s, self._wall_s = record.number, record.monotonic_s, record.wall_s
        decode = partial(msgspec.msgpack.decode, record.payload)
        with contextlib.suppress(*NOT_JSON):
            match record.kind:
                case Kind.BEGIN:
                    self._begin(decode(type=Begin).left, record.monotonic_s)
                case Kind.REPLY:
                    identity, body = decode(type=tuple[str, bytes])
                    self._replies.pop(identity, None)
                    self._replies[identity] = record.monotonic_s, body
                    if len(self._replies) > REPLIES:
                        self._replies.popitem(last=False)
                case Kind.EVENT:
                    event = decode(type=EventRow)
                    self._unsent.append(event)
                    self._trip = event if event.kind == TRIP else self._trip
                case Kind.SENT if self._unsent:
                    self._unsent.popleft()
                case Kind.LEARNT:
                    self._learnt = record.payload

    def left(self, now_s: float) -> Recalled:
        """Return what the next segment begins with.

        Args:
            now_s: Present time, monotonic.
        """
        found = self._replies.items()
        replies = tuple((one, max(0.0, now_s - born_s), body) for one, (born_s, body) in found)
        return Recalled(replies, tuple(self._unsent), self._trip, self._learnt, self.number)

    def recalled(self, now: datetime, file: int, flaws: tuple[str, ...]) -> Recalled:
        """Return what the next run begins with; ages follow the wall clock.

        Args:
            now: Present time, UTC.
            file: Number of the last file.
            flaws: What could not be read.
        """
        since_s = max(0.0, now.timestamp() - self._wall_s)
        return msgspec.structs.replace(self.left(self._time_s + since_s), file=file, flaws=flaws)


# Files of the log of a drive: their names, their records, and what the next run recalls of them.

_NAME = re.compile(r"(?P<number>\d{8})-(?P<session>\d{8}T\d{12}Z)-(?P<part>\d{4,})\.log")


@dataclass(frozen=True, slots=True, order=True)
class LogFile:
    """One file of the log.

    Attributes:
        number: Running number in the log.
        session: Start of the session, as in names of files.
        part: Segment of the session.
        path: The file.
    """

    number: int
    session: str
    part: int
    path: Path

    def begin(self) -> Begin | None:
        """Return its first record, None where that cannot be read.

        Raises:
            RecordingError: The file cannot be read.
        """
        first = next(read_frames(_content(self.path)), None)
        if isinstance(first, Record) and first.kind is Kind.BEGIN:
            with contextlib.suppress(*NOT_JSON):
                return msgspec.msgpack.decode(first.payload, type=Begin)
        return None


def new_file(folder: Path, number: int, started: datetime, part: int) -> LogFile:
    """Return the file of a number, which need not exist."""
    session = time_in_name(started)
    path = folder / f"{number:08}-{session}-{part:04}.log"
    return LogFile(number, session, part, path)


def log_files(folder: Path, session: str | None = None) -> list[LogFile]:
    """Return the files of a log in their order, none where there is no such folder.

    Args:
        folder: Folder of the log.
        session: Start of one session, None for all.

    Raises:
        RecordingError: The folder cannot be read.
    """
    try:
        paths = list(folder.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as problem:
        raise RecordingError(folder, reason_of(problem)) from problem
    found = ((path, _NAME.fullmatch(path.name)) for path in paths)
    return sorted(
        LogFile(int(match["number"]), match["session"], int(match["part"]), path)
        for path, match in found
        if match and session in {None, match["session"]}
    )


def unarchived(directory: Path, info: SessionInfo) -> list[LogFile]:
    """Return the files of the log with what a session does not have yet.

    Args:
        directory: Directory of the session.
        info: Its facts.

    Raises:
        RecordingError: The folder of the log cannot be read.
    """
    if not info.log:
        return []
    files = log_files(directory.parent / info.log, time_in_name(info.started))
    return [file for file in files if file.part > info.segments]


def is_live(folder: Path) -> bool:
    """Return whether a daemon writes a log."""
    try:
        with log_files(folder)[-1].path.open("rb") as newest:
            fcntl.flock(newest, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (IndexError, OSError):
        pass
    return False


def in_progress(directory: Path, info: SessionInfo) -> bool:
    """Return whether a daemon records a session now.

    Args:
        directory: Directory of the session.
        info: Its facts.

    Raises:
        RecordingError: The folder of its log cannot be read.
    """
    return info.ended is Ending.OPEN and bool(info.log) and is_live(directory.parent / info.log)


def records(files: Sequence[LogFile], losses: list[str] | None = None) -> Iterator[Record]:
    """Yield the records of files, each once.

    A record that a failing disk took in part is in the next file, too.

    Args:
        files: Files of one log, in their order.
        losses: Takes what cannot be read, in words.

    Raises:
        RecordingError: A file cannot be read at all.
    """
    losses = [] if losses is None else losses
    last = 0
    for file in files:
        for found in read_frames(_content(file.path)):
            if isinstance(found, tuple):
                begin, end = found
                losses.append(f"{file.path.name}: bytes {begin} to {end} cannot be read")
            elif found.number > last or found.kind is Kind.BEGIN:
                last = max(last, found.number)
                yield found


def last_of(files: Sequence[LogFile], *kinds: Kind) -> Record | None:
    """Return the last record of some kinds in files of one log, None for none.

    Raises:
        RecordingError: A file cannot be read at all.
    """
    found = (record for record in records(files) if record.kind in kinds)
    return next(iter(deque(found, maxlen=1)), None)


def recall(folder: Path, now: datetime) -> Recalled:
    """Return what an earlier run has left in its log; what cannot be read is named in it.

    Args:
        folder: Folder of the log.
        now: Present time, UTC.
    """
    flaws: list[str] = []
    try:
        files = log_files(folder)
    except RecordingError as problem:
        return Recalled(flaws=(str(problem),))
    memory = LogMemory(Recalled(), 0.0)
    for file in since_last_begin(files, flaws):
        try:
            for record in records([file], flaws):
                memory.take(record)
        except RecordingError as problem:
            flaws.append(str(problem))
    places = tuple(f"{folder}/{flaw.removeprefix(f'{folder}/')}" for flaw in flaws)
    return memory.recalled(now, files[-1].number if files else 0, places)


def since_last_begin(files: Sequence[LogFile], flaws: list[str]) -> Sequence[LogFile]:
    """Return the files from the last one on whose first record can be read.

    Args:
        files: Files of one log, in their order.
        flaws: Takes what cannot be read, in words.
    """
    for place in reversed(range(len(files))):
        try:
            if files[place].begin() is not None:
                return files[place:]
        except RecordingError as problem:
            flaws.append(str(problem))
    flaws += [f"{file.path.name}: its first record cannot be read" for file in files]
    return ()


def _content(path: Path) -> bytes:
    """Return a file of the log; nothing of one that was removed meanwhile."""
    try:
        return read_regular(path, LARGEST_BYTES)
    except FileNotFoundError:
        return b""
    except OSError as problem:
        raise RecordingError(path, reason_of(problem)) from problem


# Disk space set aside for a full disk: events, the end of a session, and the record of a trip.

_RESERVE = ".reserve"
_RESERVE_BYTES = 2 << 20
"""Two records of a trip, each of 70 s at full rate."""


def set_aside(folder: Path) -> None:
    """Occupy the reserve, where that is not done yet.

    Raises:
        OSError: There is too little space for the reserve and as much again to record into, or
            something that is no file has its name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path, held = folder / _RESERVE, 0
    if path.exists():
        require_regular(path)
        held = path.stat().st_size
    if held >= _RESERVE_BYTES:
        return
    if shutil.disk_usage(folder).free < 2 * _RESERVE_BYTES - held:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
    with path.open("ab") as file:
        os.posix_fallocate(file.fileno(), 0, _RESERVE_BYTES)


def release(folder: Path) -> None:
    """Give the reserve back to the disk."""
    (folder / _RESERVE).unlink(missing_ok=True)
