"""A session's directory: its name, the facts about it in `session.json`, and its marks.

A session holds `session.json`, `config.toml`, and the segments of its tables (`segments.py`). The
directory appears with its first files in it, so that none is ever empty. What of a session is in
the log only is read from there: `session.json` names its folder.
"""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from enum import StrEnum
from itertools import chain, count
from pathlib import Path
from typing import Annotated, Any

import msgspec

from adaptdrive.util import quantity
from adaptdrive.util.errors import NOT_JSON, RecordingError, reason_of
from adaptdrive.util.files import read_regular, replace_regular

# A session's directory: its name, and the facts about it in `session.json`.

FORMAT = 1

INFO_FILE = "session.json"
CONFIG_FILE = "config.toml"
TRIP_PREFIX = "trip-"
"""Beginning of the name of a trip's record; without a session it is next to the sessions."""
TRIP_TEXT = "trip.txt"
"""File of a trip's record; its first line is the cause."""
TIME_IN_NAME = "%Y%m%dT%H%M%S%fZ"
"""A time as the names of files have it, such as `20261121T012209000000Z`."""


class TableName(StrEnum):
    """Name of a table of a session."""

    TICKS = "ticks"
    SLOW = "slow"
    SENSORS = "sensors"
    EVENTS = "events"
    COMMANDS = "commands"


TABLES: tuple[str, ...] = (TableName.TICKS, TableName.SLOW, TableName.SENSORS)

NO_SESSION = "it holds no session; sessions are looked for here unless another folder is named"

PARTS = (INFO_FILE, f"{TableName.EVENTS}-*.parquet", f"{TableName.TICKS}-*.parquet")
"""Files by which a folder is known as a session, although one of them may be lost."""


class Ending(StrEnum):
    """Kind of end of a session."""

    OPEN = "open"
    """Still being written, or its daemon was killed and has not been started again."""
    ORDERLY = "orderly"
    """The daemon ended it; `dropped` counts what is missing."""
    CUT = "cut"
    """The daemon was killed; complete up to its last flush, and closed at a later start."""


class Dropped(msgspec.Struct, frozen=True):
    """Reports that could not be recorded; operator commands are among the events."""

    ticks: int = 0
    slow: int = 0
    events: int = 0

    def __add__(self, other: Dropped) -> Dropped:
        return Dropped(self.ticks + other.ticks, self.slow + other.slow, self.events + other.events)

    def __str__(self) -> str:
        return f"{self.ticks} ticks, {self.slow} slow steps and {self.events} events or commands"


class SensorColumn(msgspec.Struct, frozen=True):
    """One column of the sensor buses.

    Attributes:
        name: Its name on disk, such as `module.water`.
        unit: Unit, empty where it is not known.
        meaning: What the value is.
        source: Where it comes from.
    """

    name: str
    unit: str
    meaning: str
    source: str


_MOST_TICKS = 1_000_000_000
"""More than any slow period has: three months."""


class SessionInfo(msgspec.Struct, frozen=True):
    """Contents of `session.json`.

    Attributes:
        drive: Name of the drive.
        version: Version of adaptdrive that recorded it.
        started: Start, UTC.
        ticks_per_period: Q.
        latency_ticks: Fast ticks from a slow sample to its effect.
        line_frequency_Hz: Nominal line frequency.
        ended: How it ended.
        dropped: What is missing from it.
        prior: Estimates of an earlier run that its controller started from.
        histograms: Counts of the times of its ticks by bin, up to the last segment that is closed.
        output_unit: Unit of the regulated quantity.
        display: Unit in which people see it, None for its own.
        manipulated: What the drive is commanded, and gives.
        segments: Number of the last segment that is closed.
        resolution: Step of the output that an earlier run had found, 0 for none.
        rows: Rows of its tables up to that segment.
        first_sequence: Running number of the first tick: 0 but in the record of a trip.
        losses: What of its log could not be read, in words.
        sensors: Columns of the sensor buses.
        log: Folder of the log with what follows the closed segments, from that of the sessions on.
        format: Version of the layout of the files.
    """

    drive: str
    version: str
    started: datetime
    ticks_per_period: Annotated[int, msgspec.Meta(ge=1, le=_MOST_TICKS)]
    latency_ticks: int
    line_frequency_Hz: Annotated[float, msgspec.Meta(gt=0.0)]
    ended: Ending = Ending.OPEN
    dropped: Dropped = Dropped()
    prior: tuple[float, ...] | None = None
    histograms: dict[str, tuple[int, ...]] = {}
    output_unit: str = ""
    display: quantity.Display | None = None
    manipulated: quantity.Given = quantity.BOOST
    segments: int = 0
    resolution: float = 0.0
    rows: dict[str, int] = {}
    first_sequence: int = 0
    losses: tuple[str, ...] = ()
    sensors: tuple[SensorColumn, ...] = ()
    log: str = ""
    format: int = FORMAT

    @property
    def shown(self) -> quantity.Display:
        """Unit in which people see the output."""
        return self.display or quantity.Display(self.output_unit)


def sessions_directory(configured: Path | None, environment: Mapping[str, str]) -> Path:
    """Return the folder of sessions: configured, else in `$STATE_DIRECTORY`, else `./sessions`."""
    if configured is not None:
        return configured
    # systemd joins several state directories with colons; the first is the daemon's own.
    state = environment.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(state) / "sessions" if state else Path("sessions")


def create_session(sessions: Path, info: SessionInfo, config_text: str) -> Path:
    """Make the directory of a new session, such as `20261121T012209Z_motor`, with its facts.

    Args:
        sessions: Folder of all sessions.
        info: What is known about it; start and drive give the name.
        config_text: The configuration in force, as TOML.

    Returns:
        The directory; a second one in the same second gets `-2` after its name.

    Raises:
        OSError: The directory cannot be made.
    """
    sessions.mkdir(parents=True, exist_ok=True)
    # with the drive: in two containers two processes have one number
    number = threading.get_native_id()
    with unfinished_folder(sessions / f".new-{number}_{info.drive}") as unfinished:
        # without a sync, for which the thread of the log would wait: all of it is in the log
        (unfinished / CONFIG_FILE).write_text(config_text, encoding="utf-8")
        (unfinished / INFO_FILE).write_bytes(_text(info))
        names = chain([_name(info)], (f"{_name(info)}-{place}" for place in count(2)))
        free = (sessions / name for name in names if not os.path.lexists(sessions / name))
        return unfinished.rename(next(free))


@contextmanager
def unfinished_folder(path: Path) -> Iterator[Path]:
    """Make a folder, which is removed at the end where it still has its name.

    Raises:
        OSError: It cannot be made.
    """
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir()
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)


def session_of(sessions: Path, info: SessionInfo) -> Path | None:
    """Return the directory of a session, None where there is none.

    A copy that somebody has made of it in the same folder has a longer name, or quite another one.

    Args:
        sessions: Folder of all sessions.
        info: The session.
    """
    name, found = _name(info), session_directories(sessions)
    # the likeliest first
    for path in sorted(found, key=lambda one: (not one.name.startswith(name), len(one.name))):
        with suppress(RecordingError):
            known = read_info(path)
            if (known.started, known.drive) == (info.started, info.drive):
                return path
    return None


def _name(info: SessionInfo) -> str:
    """Return the name of the directory of a session, where no other one has it."""
    return f"{info.started:%Y%m%dT%H%M%SZ}_{info.drive}"


def time_in_name(time: datetime) -> str:
    """Return a time as the names of files have it."""
    return time.strftime(TIME_IN_NAME)


def session_directories(sessions: Path, files: Sequence[str] = (INFO_FILE,)) -> Iterator[Path]:
    """Yield the directories of sessions in a folder, the oldest first.

    Args:
        sessions: The folder.
        files: Names by one of which a session is known; with `PARTS` those are found, too, of which
            `session.json` is lost.
    """
    if sessions.is_dir():
        finished = (path for path in sessions.iterdir() if not path.name.startswith("."))
        found = [path for path in finished if has_any(path, files)]
        yield from sorted(found, key=lambda path: path.name.removeprefix(TRIP_PREFIX))


def has_any(directory: Path, files: Sequence[str]) -> bool:
    """Return whether a folder has a file with one of some names."""
    try:
        return any(True for file in files for _ in directory.glob(file))
    except FileNotFoundError:  # removed meanwhile
        return False


def write_facts(directory: Path, info: SessionInfo, config_text: str) -> None:
    """Write what is known about a session before its first tick."""
    (directory / CONFIG_FILE).write_text(config_text, encoding="utf-8")
    write_info(directory, info)


def write_info(directory: Path, info: SessionInfo) -> None:
    """Write `session.json`, so that a reader sees the old one or the new one, whole."""
    replace_regular(directory / INFO_FILE, _text(info))


def _text(info: SessionInfo) -> bytes:
    return msgspec.json.format(msgspec.json.encode(info), indent=2) + b"\n"


def read_info(directory: Path) -> SessionInfo:
    """Read `session.json`.

    Raises:
        RecordingError: It is absent, damaged, or of a format that this version cannot read.
    """
    path = directory / INFO_FILE
    try:
        text = read_regular(path)
        version = msgspec.json.decode(text, type=dict[str, Any]).get("format")
        if version != FORMAT:
            raise RecordingError(path, f"format {version} is not {FORMAT}, the one known here")
        return msgspec.json.decode(text, type=SessionInfo)
    except OSError as problem:
        raise RecordingError(path, reason_of(problem)) from problem
    except NOT_JSON as problem:
        raise RecordingError(path, str(problem)) from problem
