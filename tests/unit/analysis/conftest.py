"""A recorded session of a motor that is driven in a closed loop, with a trip."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import msgspec
import pytest

from adaptdrive.recording.records import CommandRow, EventRow, Header
from adaptdrive.recording.session import create_session
from adaptdrive.runtime.reports import LoadReport, TickReport
from tests.unit.app.test_replay import EXAMPLE, lived
from tests.unit.recording.material import INFO, make_batch, record_messages

BEGIN_s = 1000.0
TRIP_s = 30.0
SECONDS = 50
TRIP = EventRow(
    *(INFO.started, 0, "trip", "alarm", "stale: 54 ms", BEGIN_s + TRIP_s, 1),
    trip_kind="no-message",
)


@pytest.fixture(scope="session")
def session_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    text = EXAMPLE.read_text(encoding="utf-8").replace(
        '"adaptdrive.dbc"', f'"{EXAMPLE.with_name("adaptdrive.dbc")}"'
    )
    info = msgspec.structs.replace(INFO, output_unit="V")
    directory = create_session(tmp_path_factory.mktemp("sessions"), info, text)
    ticks, slow = stamped(*lived((0.0113, 40.0, 300.7)))
    batch = msgspec.structs.replace(
        make_batch(ticks, slow, last=True),
        utc_offset_s=INFO.started.timestamp() - BEGIN_s,
        events=[TRIP],
        commands=[
            CommandRow(
                INFO.started + timedelta(seconds=1),
                BEGIN_s + 1.0,
                *("op-1", "setpoint", "3.1", "ann@bench", True, "", 2),
            )
        ],
    )
    record_messages(directory, Header(info, text), batch)
    return directory


def stamped(
    ticks: list[TickReport], slow: list[LoadReport]
) -> tuple[list[TickReport], list[LoadReport]]:
    """The same with the times at which they were made."""
    timed = [replace(one, time_s=BEGIN_s + one.sequence / 120) for one in ticks]
    return timed, [replace(one, time_s=BEGIN_s + one.snapshot.tick / 120) for one in slow]
