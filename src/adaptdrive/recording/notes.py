"""Events and commands of a session: those in its folder, and those that are in the log only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from adaptdrive.errors import NOT_JSON, RecordingError
from adaptdrive.recording.event_log import LogContents, read_commands, read_events
from adaptdrive.recording.frames import Kind, Record
from adaptdrive.recording.log_files import LogFile, records, unarchived
from adaptdrive.recording.records import CommandRow, EventRow
from adaptdrive.recording.session import EVENTS_FILE, Dropped, read_info


@dataclass(slots=True)
class LoggedNotes:
    """Events, commands and the end of a session in files of the log.

    Attributes:
        events: Events in their order.
        commands: Operator commands in their order.
        dropped: What could not be kept, None where nothing is said of it.
        ended: Whether the daemon ended in order.
        rows: Whether there are rows of tables.
    """

    events: list[EventRow] = field(default_factory=list)
    commands: list[CommandRow] = field(default_factory=list)
    dropped: Dropped | None = None
    ended: bool = False
    rows: bool = False

    def take(self, record: Record) -> None:
        """Take a record.

        Raises:
            DecodeError: It is damaged.
        """
        match record.kind:
            case Kind.EVENT:
                self.events.append(msgspec.msgpack.decode(record.payload, type=EventRow))
            case Kind.COMMAND:
                self.commands.append(msgspec.msgpack.decode(record.payload, type=CommandRow))
            case Kind.DROPPED:
                self.dropped = msgspec.msgpack.decode(record.payload, type=Dropped)
            case Kind.END:
                self.ended = True
            case Kind.TICKS | Kind.SLOW | Kind.SENSORS:
                self.rows = True
            case _:
                pass


def logged_notes(files: Sequence[LogFile], losses: list[str] | None = None) -> LoggedNotes:
    """Return the events and commands in files of the log.

    Args:
        files: Files of one session, in their order.
        losses: Takes what cannot be read, in words.

    Raises:
        RecordingError: A file cannot be read at all.
    """
    losses = [] if losses is None else losses
    notes = LoggedNotes()
    for record in records(files, losses):
        try:
            notes.take(record)
        except NOT_JSON as problem:
            losses.append(f"record {record.number}: {problem}")
    return notes


def session_notes(directory: Path) -> LogContents:
    """Return the events and commands of a session, also where its facts are lost.

    Raises:
        RecordingError: They are damaged.
    """
    path = directory / EVENTS_FILE
    events, commands = read_events(path), read_commands(path)
    try:
        logged = logged_notes(unarchived(directory, read_info(directory)))
    except RecordingError:
        logged = LoggedNotes()
    known = {row.number for row in events} | {row.number for row in commands}
    return LogContents(
        events + tuple(row for row in logged.events if row.number not in known),
        commands + tuple(row for row in logged.commands if row.number not in known),
    )


def read_notes(directory: Path) -> LogContents:
    """Return the events and commands of a session, or the damage of a damaged one."""
    try:
        return session_notes(directory)
    except RecordingError as problem:
        return LogContents(damage=f"{problem}; its events and commands cannot be read")
