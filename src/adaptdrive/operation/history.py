"""The slow steps of the last hour and the readings of 300 s, for a page that is opened late.

Of the steps in each 12 s at most two are kept: those with the lowest and the highest
output, so that a plot shows every overshoot. Readings are kept as they come, ten a second.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

import msgspec

from adaptdrive.operation.clock import Monotonic
from adaptdrive.operation.messages import Payload, encode

SPAN_S = 3600.0
BUCKET_S = 12.0
PAGE_ROWS = 50
READING_SPAN_S = 300.0
PAGE_READINGS = 500
KEYS = (
    *("time", "k", "reference", "output", "boost_reference_V", "applied_V"),
    *("controller", "mode", "accepted", "reason", "estimates"),
)
"""Keys of a row: those of `telemetry/load` that a plot needs."""

_ROWS = 2 * math.ceil(SPAN_S / BUCKET_S)
_READINGS = math.ceil(READING_SPAN_S * 10.0)


@dataclass(frozen=True, slots=True)
class _Row:
    taken_s: float
    output: float
    body: bytes

    @property
    def bucket(self) -> float:
        return self.taken_s // BUCKET_S


class History:
    """The slow steps of the last hour, at most two for each 12 s, and the readings of 300 s."""

    def __init__(self, monotonic: Monotonic) -> None:
        self._monotonic = monotonic
        self._rows: deque[_Row] = deque(maxlen=_ROWS)
        self._readings: deque[bytes] = deque(maxlen=_READINGS)
        self._asked: tuple[float | None, float | None] = (None, None)

    def add(self, message: Payload) -> None:
        """Take in a payload of `telemetry/load`."""
        self._asked = (message["reference"], message["boost_reference_V"])
        body = encode({key: message[key] for key in KEYS})
        row = _Row(self._monotonic(), message["output"], body)
        bucket = [row]
        while self._rows and self._rows[-1].bucket == row.bucket:
            bucket.insert(0, self._rows.pop())
        self._rows.extend(_extremes(bucket))

    def add_reading(self, message: Payload) -> None:
        """Take in a payload of `telemetry/drive`; nothing is asked for while the bridge is off."""
        time_s = round(message["time"].timestamp(), 2)
        asked = self._asked if message["command"].bridge else (None, None)
        reading = (time_s, message["output"], message["boost_voltage_V"], *asked)
        self._readings.append(msgspec.json.encode(reading))

    def pages(self, time: datetime) -> Iterator[Payload]:
        """Yield the payloads of an answer, the newest rows first.

        Args:
            time: Time of the answer, the same in each of its pages.
        """
        oldest_s = self._monotonic() - SPAN_S
        rows = [row.body for row in self._rows if row.taken_s >= oldest_s]
        readings = list(self._readings)
        count = max(1, math.ceil(len(rows) / PAGE_ROWS), math.ceil(len(readings) / PAGE_READINGS))
        for page in range(1, count + 1):
            yield {
                "time": time,
                "page": page,
                "pages": count,
                "rows": _part(rows, page, PAGE_ROWS),
                "readings": _part(readings, page, PAGE_READINGS),
            }


def _part(bodies: list[bytes], page: int, size: int) -> list[msgspec.Raw]:
    """Return the bodies of a page; the first page has the newest."""
    end = max(0, len(bodies) - (page - 1) * size)
    return [msgspec.Raw(body) for body in bodies[max(0, end - size) : end]]


def _extremes(rows: list[_Row]) -> list[_Row]:
    """Return the rows with the lowest and the highest output, in the order of their times."""
    if len(rows) <= 2:
        return rows
    kept = {min(rows, key=_level).taken_s, max(rows, key=_level).taken_s}
    return [row for row in rows if row.taken_s in kept][:2]


def _level(row: _Row) -> float:
    return row.output if math.isfinite(row.output) else math.inf
