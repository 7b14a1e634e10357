"""The records of trips at the end of a session."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from adaptdrive.recording.batches import EventRow, Header
from adaptdrive.recording.black_box import TRIP, BlackBox
from adaptdrive.runtime.reports import Severity
from tests.recording.material import INFO, make_batch, make_tick


@pytest.mark.parametrize("timeout_s", [0.0, -1.0])
async def test_a_trip_for_which_no_time_is_left_is_reported_as_such(
    tmp_path: Path, timeout_s: float
) -> None:
    reports: list[tuple[Severity, str]] = []
    box = BlackBox(
        Header(INFO, "", str(tmp_path)),
        lambda severity, detail: reports.append((severity, detail)),
        lambda: 100.0,
    )
    trip = EventRow(INFO.started, 1, TRIP, "alarm", "manual", 0.0, 1)
    box.keep(msgspec.structs.replace(make_batch([make_tick(0)]), events=[trip]))
    await box.finish(timeout_s)
    words = "the record of the trip is not written: no time was left"
    assert reports == [(Severity.ALARM, words)]
