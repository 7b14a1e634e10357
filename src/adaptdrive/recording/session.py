"""A session's directory: its name, its files and the facts about it in `session.json`.

A session holds `session.json`, `config.toml`, `events.sqlite`, and ticks and slow steps twice in
its life: as Arrow streams (`ticks.arrows`, `slow.arrows`) while it is written, because a stream
that breaks off loses only its last batch, and as Parquet (`ticks.parquet`, `slow.parquet`) once
it has ended. A stream is removed when its Parquet file is complete on disk, and not before.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from itertools import count
from pathlib import Path

import msgspec

from adaptdrive.errors import RecordingError

FORMAT = 1
INFO_FILE = "session.json"
CONFIG_FILE = "config.toml"
EVENTS_FILE = "events.sqlite"
TICKS = "ticks"
SLOW = "slow"


class Ending(StrEnum):
    """How a session ended."""

    OPEN = "open"
    """Still being written, or its writer died."""
    ORDERLY = "orderly"
    """The control process said goodbye."""
    CUT = "cut"
    """The control process vanished; complete up to its last flush."""


class Dropped(msgspec.Struct, frozen=True):
    """Reports that could not be recorded."""

    ticks: int = 0
    slow: int = 0
    events: int = 0

    def __str__(self) -> str:
        return f"{self.ticks} ticks, {self.slow} slow steps and {self.events} events"


class SessionInfo(msgspec.Struct, frozen=True):
    """What `session.json` says.

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
        histograms: Counts of the times of its ticks by bin, once it has ended.
        format: Version of the layout of the files.
    """

    drive: str
    version: str
    started: datetime
    ticks_per_period: int
    latency_ticks: int
    line_frequency_Hz: float
    ended: Ending = Ending.OPEN
    dropped: Dropped = Dropped()
    prior: tuple[float, ...] | None = None
    histograms: dict[str, tuple[int, ...]] = {}
    format: int = FORMAT


@dataclass(frozen=True, slots=True)
class NewSession:
    """A session about to be recorded.

    Attributes:
        directory: Its own, empty directory.
        info: What is known about it.
        config_text: The configuration in force, as TOML.
    """

    directory: Path
    info: SessionInfo
    config_text: str


def sessions_directory(configured: Path | None, environment: Mapping[str, str]) -> Path:
    """Where sessions lie: as configured, else `$STATE_DIRECTORY/sessions`, else `./sessions`."""
    if configured is not None:
        return configured
    # systemd joins several state directories with colons; the first is the daemon's own.
    state = environment.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(state) / "sessions" if state else Path("sessions")


def create_session(sessions: Path, info: SessionInfo, config_text: str) -> NewSession:
    """Make the directory of a new session, such as `20261121T012209Z_motor`.

    Args:
        sessions: Where sessions lie; made when absent.
        info: Facts about the session; its start and drive give the name.
        config_text: The configuration in force, as TOML.

    Returns:
        The new session; a second one in the same second gets `-2` after its name.

    Raises:
        RecordingError: The directory cannot be made.
    """
    sessions = sessions.absolute()
    name = f"{info.started:%Y%m%dT%H%M%SZ}_{info.drive}"
    for number in count(1):
        directory = sessions / (name if number == 1 else f"{name}-{number}")
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            if not directory.exists():
                raise RecordingError(directory, f"{sessions} is not a directory") from None
        except OSError as problem:
            raise RecordingError(directory, problem.strerror or str(problem)) from problem
        else:
            return NewSession(directory, info, config_text)
    raise AssertionError


def find_session(name: str, sessions: Path) -> Path:
    """The session that an operator names by path, or by its name in `sessions`.

    Raises:
        RecordingError: There is none.
    """
    for directory in (Path(name), sessions / name):
        if (directory / INFO_FILE).is_file():
            return directory
    raise RecordingError(name, f"no such session, neither as a path nor in {sessions}")


def write_info(directory: Path, info: SessionInfo) -> None:
    """Write `session.json`, so that a reader sees the old one or the new one, whole."""
    unfinished = directory / f"{INFO_FILE}.unfinished"
    with unfinished.open("wb") as file:
        file.write(msgspec.json.format(msgspec.json.encode(info), indent=2) + b"\n")
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(directory / INFO_FILE)


def read_info(directory: Path) -> SessionInfo:
    """Read `session.json`.

    Raises:
        RecordingError: It is absent, damaged, or of a format that this version cannot read.
    """
    path = directory / INFO_FILE
    try:
        text = path.read_bytes()
        version = msgspec.json.decode(text, type=_Format).format
        if version != FORMAT:
            raise RecordingError(path, f"format {version} is not {FORMAT}, the one known here")
        return msgspec.json.decode(text, type=SessionInfo)
    except OSError as problem:
        raise RecordingError(path, problem.strerror or str(problem)) from problem
    except (msgspec.DecodeError, UnicodeDecodeError) as problem:
        raise RecordingError(path, str(problem)) from problem


class _Format(msgspec.Struct):
    format: int
