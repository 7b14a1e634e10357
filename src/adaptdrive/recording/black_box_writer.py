"""The process that writes the record of one trip, a small session of its own, and its figure.

It is started as `python -m adaptdrive.recording.black_box_writer SESSIONS NUMBER`, the number being
that of the event of the trip, reads a header and batches from its standard input, and uses the
reserve where the disk is full.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO, TypeVar

import msgspec

from adaptdrive.errors import NOT_JSON
from adaptdrive.recording import reserve
from adaptdrive.recording.batches import Batch, EventRow, Header, News, read_frames
from adaptdrive.recording.black_box import NO_FIGURE, TRIP
from adaptdrive.recording.housekeeping import ERRORS, Housekeeper
from adaptdrive.recording.left_trips import DamagedTripError
from adaptdrive.recording.session import TRIP_PREFIX, Dropped, Ending, time_in_name
from adaptdrive.recording.session_writer import SessionWriter
from adaptdrive.recording.tables import ticks_batch, ticks_schema
from adaptdrive.recording.writer import send_to_parent, step_aside
from adaptdrive.runtime.reports import Severity

TEXT_FILE = "trip.txt"
_FIGURE_MODULE = "adaptdrive.analysis"
_FIGURE_PATIENCE_S = 120.0

_Message = TypeVar("_Message", Header, Batch)


def write_trip(source: BinaryIO, number: int, sessions: Path) -> Path:
    """Write the record of a trip, unless it is there already.

    Args:
        source: A header and batches.
        number: Running number of the event of the trip.
        sessions: Folder of all sessions, which may have been moved since the trip.

    Returns:
        Its directory, within that of the session where that is still there.

    Raises:
        DamagedTripError: What was read makes no record.
        OSError: It cannot be written, not even with the reserve.
    """
    header, batches = _read(source)
    trip = _trip_in(batches, number)
    sessions.mkdir(parents=True, exist_ok=True)
    session = sessions / Path(header.directory).name  # the folder of all where there was none
    parent = session if session.is_dir() else sessions
    return _with_reserve(sessions, lambda: _write(parent, header, batches, trip))


def _read(source: BinaryIO) -> tuple[Header, list[Batch]]:
    """Return the header and the batches.

    Raises:
        DamagedTripError: There is no header, or a message cannot be decoded.
    """
    frames = read_frames(source)
    if (first := next(frames, None)) is None:
        raise DamagedTripError("it is empty, or breaks off in its first message")
    return _decoded(first, Header, 1), [
        _decoded(frame, Batch, place) for place, frame in enumerate(frames, 2)
    ]


def _decoded(frame: bytes, kind: type[_Message], place: int) -> _Message:
    try:
        return msgspec.msgpack.decode(frame, type=kind)
    except NOT_JSON as problem:
        raise DamagedTripError(f"its message {place} cannot be decoded") from problem


def _trip_in(batches: Sequence[Batch], number: int) -> EventRow:
    for event in (event for batch in batches for event in batch.events):
        if event.kind == TRIP and event.number == number:
            return event
    raise DamagedTripError(f"it has no trip of number {number}")


def _with_reserve(sessions: Path, write: Callable[[], Path]) -> Path:
    try:
        return write()
    except DamagedTripError:
        raise
    except ERRORS:
        # whatever it was: the reserve is what can be done about it
        reserve.release(sessions)
        return write()


def _write(parent: Path, header: Header, batches: Sequence[Batch], trip: EventRow) -> Path:
    directory = parent / f"{TRIP_PREFIX}{time_in_name(trip.time)}-{trip.number}"
    if directory.exists():
        return directory  # the process before this was ended while it drew the figure
    unfinished = parent / f".trip-{header.info.drive}"  # drives may share the folder of all
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir()
    try:
        info = msgspec.structs.replace(header.info, first_sequence=_first_sequence(batches))
        of_trip = msgspec.structs.replace(header, directory=str(unfinished), info=info)
        _write_tables(of_trip, batches)
    except (LookupError, ValueError) as problem:  # those of Arrow included
        shutil.rmtree(unfinished, ignore_errors=True)
        raise DamagedTripError("its rows make no table") from problem
    events = [event for batch in batches for event in batch.events]
    (unfinished / TEXT_FILE).write_text(_text(header, trip, events), encoding="utf-8")
    return unfinished.rename(directory)


def _first_sequence(batches: Sequence[Batch]) -> int | None:
    """Return the running number of the first tick, None without ticks."""
    first = next((batch for batch in batches if batch.tick_rows), None)
    if first is None:
        return None
    ticks = ticks_batch(first.ticks, first.tick_rows, ticks_schema(), first.utc_offset_s)
    number: int = ticks.column("sequence")[0].as_py()
    return number


def _write_tables(header: Header, batches: Sequence[Batch]) -> None:
    warnings: list[str] = []
    housekeeper = Housekeeper(warnings.append)
    writer = SessionWriter(header, lambda _severity, _detail: None, housekeeper)
    try:
        for batch in batches:
            writer.write(batch)
        writer.close(Ending.ORDERLY, Dropped())
    except BaseException:
        writer.abandon()
        raise
    finally:
        housekeeper.finish()
    if warnings:
        raise OSError("; ".join(warnings))


def _text(header: Header, trip: EventRow, events: Sequence[EventRow]) -> str:
    lines = [
        trip.detail,
        "",
        f"drive {header.info.drive}, {trip.time:%Y-%m-%dT%H:%M:%S.%f}Z, tick {trip.tick}",
        "",
        "events before and after:",
        *(f"{one.time:%H:%M:%S.%f} {one.severity:<7} {one.kind}: {one.detail}" for one in events),
    ]
    return "\n".join(lines) + "\n"


def draw(directory: Path) -> bool:
    """Draw the figure of a trip, where the libraries for that are installed."""
    if importlib.util.find_spec("matplotlib") is None:
        return False
    command = [sys.executable, "-P", "-m", _FIGURE_MODULE, str(directory)]
    try:
        drawn = subprocess.run(  # noqa: S603 - this program itself
            command, capture_output=True, timeout=_FIGURE_PATIENCE_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return drawn.returncode == 0


def main() -> None:
    """Write one trip, report it, and draw its figure."""
    step_aside()
    try:
        directory = write_trip(sys.stdin.buffer, int(sys.argv[2]), Path(sys.argv[1]))
    except DamagedTripError as damage:
        send_to_parent(News(detail=str(damage), damaged=True))
        sys.exit(str(damage))
    except ERRORS as problem:
        sys.exit(str(problem))
    _tell(f"the record of the trip is in {directory}; `adaptdrive plot {directory}` draws it")
    if NO_FIGURE not in sys.argv and draw(directory):
        _tell(f"the figure of the trip is in {directory}")


def _tell(detail: str) -> None:
    send_to_parent(News(severity=Severity.INFO.value, detail=detail))


if __name__ == "__main__":
    main()
