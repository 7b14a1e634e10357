"""Events and commands of a session: those in its folder, and those that are in the log only."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec

from adaptdrive.errors import RecordingError
from adaptdrive.recording.records import CommandRow, EventRow
from adaptdrive.recording.segments import Segment, closed_segments, segments
from adaptdrive.recording.session import COMMANDS, EVENTS, read_info

T = TypeVar("T", EventRow, CommandRow)


def session_notes(
    directory: Path, damage: list[str] | None = None
) -> tuple[tuple[EventRow, ...], tuple[CommandRow, ...]]:
    """Return the events and commands of a session, also where its facts are lost.

    Args:
        directory: Directory of the session.
        damage: Takes what cannot be read, in words; None to refuse that.

    Raises:
        RecordingError: They are damaged.
    """
    try:
        found = segments(directory, read_info(directory))
    except RecordingError:
        found = closed_segments(directory)
    events = _notes([one for one in found if one.table == EVENTS], EventRow, damage)
    commands = _notes([one for one in found if one.table == COMMANDS], CommandRow, damage)
    return tuple(events), tuple(commands)


def _notes(found: Sequence[Segment], kind: type[T], damage: list[str] | None) -> Iterator[T]:
    for segment in found:
        try:
            yield from _rows(segment, kind)
        except RecordingError as problem:
            if damage is None:
                raise
            damage.append(str(problem))


def _rows(segment: Segment, kind: type[T]) -> list[T]:
    batches = segment.batches(strict=segment.closed)
    try:
        return [row for batch in batches for row in msgspec.convert(batch.to_pylist(), list[kind])]  # type: ignore[valid-type]
    except (msgspec.ValidationError, ValueError, OverflowError) as problem:
        raise RecordingError(segment.path, f"damaged {segment.table}: {problem}") from problem
