"""Rows that killed daemons have left in a spool, written into their session at the next start."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import msgspec

from adaptdrive.errors import NOT_JSON, RecordingError
from adaptdrive.recording.batches import Batch, Header, read_frames
from adaptdrive.recording.housekeeping import ERRORS, Housekeeper
from adaptdrive.recording.segments import newest_number, segments
from adaptdrive.recording.session import (
    Ending,
    SessionLock,
    read_info,
    session_directories,
    session_name,
    set_aside,
    write_info,
)
from adaptdrive.recording.session_writer import Report, SessionWriter
from adaptdrive.recording.spool import is_free, left_spools
from adaptdrive.runtime.reports import Severity

_LOOKS, _LOOK_S = 20, 0.05
_UNFINISHED = {Ending.OPEN, Ending.LOST}
"""Endings of a session that lacks what is in its spool: it was closed without that, if at all."""


def recover(own: Path, report: Report, housekeeper: Housekeeper) -> None:
    """Write each spool whose control process is gone into its session, and remove it.

    One that cannot be written stays, is reported, and keeps no other from being written.

    Args:
        own: Spool of the session in progress, which is left alone; the others are beside it.
        report: Reports an event.
        housekeeper: Of this process.
    """
    for path in left_spools(own.parent):
        if path != own and path.is_file():
            try:
                _recover(path, report, housekeeper)
            except ERRORS as problem:
                report(Severity.WARNING, f"{path} is left as it is: {problem}")


def _recover(path: Path, report: Report, housekeeper: Housekeeper) -> None:
    with path.open("rb") as source:
        if not is_free(source):
            return
        left = _read(source)
        if left.header is None:
            unwritten: str | None = ": it cannot be read" if path.stat().st_size else ""
        else:
            header = msgspec.structs.replace(left.header, sessions=str(path.parent))
            unwritten = _write(header, left, lambda of: SessionWriter(of, report, housekeeper))
        if unwritten:
            kept = set_aside(path)
            report(Severity.WARNING, f"{kept} was not written into a session{unwritten}")
        elif unwritten is not None:
            path.unlink(missing_ok=True)


def left_batches(path: Path) -> list[Batch] | None:
    """Return the whole batches in the spool of a control process that has ended.

    Args:
        path: The spool.

    Returns:
        The batches, none without a spool; None where another process has it or it cannot be read.
    """
    try:
        with path.open("rb") as source:
            for _ in range(_LOOKS):  # its files are closed one after another
                if is_free(source):
                    left = _read(source)
                    return None if left.damage else left.batches
                time.sleep(_LOOK_S)
    except FileNotFoundError:
        return []
    except OSError:
        return None
    return None


def _write(
    header: Header, left: _Left, open_session: Callable[[Header], SessionWriter]
) -> str | None:
    """Write what a spool holds.

    Its session is beside it, also where the folder of both has been moved since.

    Returns:
        The part that cannot be written, in words, empty for none; None where another recorder
        still writes the session.
    """
    directory, batches = _session_of(header), left.batches
    if directory is not None:
        ended = read_info(directory).ended
        if ended not in _UNFINISHED:
            batches = _after_close(batches)
            if not batches:
                return ""
        if batches and not _is_left(directory):
            return None
        if batches and ended is Ending.LOST:
            _reopen(directory)
    if batches:
        name = "" if directory is None else str(directory)
        of_session = msgspec.structs.replace(header, directory=name)
        _write_batches(open_session(of_session), batches)
    return left.damage


def _after_close(batches: list[Batch]) -> list[Batch]:
    """Return the batches after the one that closed a session: events of the last moment.

    The recorder process may have been killed between the close and its acknowledgement.
    """
    closing = next((place for place, one in enumerate(batches, 1) if one.last), len(batches))
    return batches[closing:]


def _reopen(directory: Path) -> None:
    """Mark a lost session as open; its counts include all segments since its close."""
    info = read_info(directory)
    newest = newest_number(segments(directory))
    write_info(directory, msgspec.structs.replace(info, ended=Ending.OPEN, segments=newest))


def _write_batches(writer: SessionWriter, batches: Sequence[Batch]) -> None:
    """Write batches and close the session, if the last one says so.

    Otherwise it is closed with the other sessions whose recorder has died.
    """
    last = batches[-1]
    try:
        for batch in batches:
            writer.write(batch)
        if last.last:
            writer.close(Ending.ORDERLY, last.dropped)
    except BaseException:
        writer.abandon()
        raise
    if not last.last:
        writer.abandon()
        info = read_info(writer.directory)
        write_info(writer.directory, msgspec.structs.replace(info, dropped=last.dropped))


def _is_left(directory: Path) -> bool:
    claim = SessionLock.on(directory)
    if claim is None:
        return False
    claim.release()
    return True


@dataclass(frozen=True, slots=True)
class _Left:
    """Holds what is left in a spool.

    Attributes:
        header: The session, None where the first message is missing or cannot be decoded.
        batches: The batches after it, up to the first that cannot be decoded.
        damage: Messages that cannot be decoded, in words; empty for none.
    """

    header: Header | None
    batches: list[Batch]
    damage: str = ""


def _read(source: BinaryIO) -> _Left:
    """Return the messages up to the first one that breaks off, or that cannot be decoded."""
    header: Header | None = None
    batches: list[Batch] = []
    for place, frame in enumerate(read_frames(source), 1):
        try:
            if header is None:
                header = msgspec.msgpack.decode(frame, type=Header)
            else:
                batches.append(msgspec.msgpack.decode(frame, type=Batch))
        except NOT_JSON:
            return _Left(header, batches, f" from its message {place} on, which cannot be read")
    return _Left(header, batches)


def _session_of(header: Header) -> Path | None:
    """Return the folder of the session that a header describes, None where there is none yet.

    A copy that somebody has made of it beside it has a longer name, or quite another one.
    """
    name = session_name(header.info)
    likeliest_first = sorted(
        session_directories(Path(header.sessions)),
        key=lambda path: (not path.name.startswith(name), len(path.name)),
    )
    return next((path for path in likeliest_first if _is_of(header, path)), None)


def _is_of(header: Header, directory: Path) -> bool:
    try:
        info = read_info(directory)
    except RecordingError:
        return False
    return (info.started, info.drive) == (header.info.started, header.info.drive)
