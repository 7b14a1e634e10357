"""Rows of a recorded session, converted to the controller's types."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from adaptdrive.control.columns import rebuild
from adaptdrive.recording.reader import Session
from adaptdrive.recording.session import TICKS
from adaptdrive.runtime.reports import TICK_COLUMNS, TickReport

_COLUMNS = tuple(column.name for column in TICK_COLUMNS)


def recorded_ticks(session: Session) -> Iterator[TickReport]:
    """Yield the fast ticks of a session, in their order."""
    return map(partial(rebuild, TickReport), table_rows(session, TICKS, _COLUMNS))


def table_rows(session: Session, table: str, columns: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield rows of a table as Python values, without holding all of them at once."""
    for batch in session.batches(table, columns):
        yield from batch.to_pylist()
