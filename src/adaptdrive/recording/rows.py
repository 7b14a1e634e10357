"""Rows of a recorded session as the values that the controller knows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from adaptdrive.control.signals import Command, Measurement, Mode, Order, Stage

_CHUNK = 10_000
"""Rows turned into Python values at a time."""


@dataclass(frozen=True, slots=True)
class RecordedTick:
    """One fast tick as it was recorded."""

    sequence: int
    measurement: Measurement
    order: Order
    applied_k: int
    command: Command


def recorded_ticks(ticks: pa.Table) -> Iterator[RecordedTick]:
    """The fast ticks of a session, in their order."""
    return map(_tick, table_rows(ticks))


def table_rows(table: pa.Table) -> Iterator[dict[str, Any]]:
    """The rows of a table as Python values, without holding all of them at once."""
    for chunk in table.to_batches(max_chunksize=_CHUNK):
        yield from chunk.to_pylist()


def _tick(row: dict[str, Any]) -> RecordedTick:
    return RecordedTick(
        sequence=row["sequence"],
        measurement=Measurement(
            tick=row["tick"],
            tick_period_s=row["tick_period_s"],
            boost_voltage_V=row["boost_voltage_V"],
            line_voltage_V=row["line_voltage_V"],
            load_power_W=row["load_power_W"],
            output=row["output"],
            fresh=row["fresh"],
        ),
        order=Order(
            stage=Stage(row["stage"]),
            reference=row["reference"],
            mode=Mode(row["mode"]),
            pole=row["pole"],
        ),
        applied_k=row["applied_k"],
        command=Command(
            current_scale_S=row["current_scale_S"],
            boost_reference_V=row["command_boost_reference_V"],
            bridge=row["bridge"],
        ),
    )
