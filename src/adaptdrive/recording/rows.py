"""Rows of a recorded session as the values that the controller knows."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import pyarrow as pa

from adaptdrive.control.columns import rebuild
from adaptdrive.runtime.reports import TickReport

_CHUNK = 10_000
"""Rows turned into Python values at a time."""


def recorded_ticks(ticks: pa.Table) -> Iterator[TickReport]:
    """Yield the fast ticks of a session, in their order."""
    return map(partial(rebuild, TickReport), table_rows(ticks))


def table_rows(table: pa.Table) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table as Python values, without holding all of them at once."""
    for chunk in table.to_batches(max_chunksize=_CHUNK):
        yield from chunk.to_pylist()
