"""Files that were removed from a session, found by the counts of their rows."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from adaptdrive.recording.reader import Verification, read_session, verify
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import Dropped, SensorColumn, read_info, write_info
from tests.unit.mqtt.peers import load_report
from tests.unit.recording.material import INFO, Batch, make_batch, make_tick, record_messages

SENSORS = (SensorColumn("bath.inflow", "K", "inflow temperature", "sensor bus bath"),)


def batch(number: int, *, last: bool = False) -> Batch:
    """One tick, one slow step and one reading of the sensors."""
    time_s = 50.0 + number
    packed = make_batch(
        [make_tick(number)], [replace(load_report(number), time_s=time_s)], last=last
    )
    reading = {"monotonic_s": time_s, "bath.inflow": 288.5}
    return msgspec.structs.replace(packed, sensors=[reading])


def record_in_two_parts(directory: Path) -> None:
    """A recorder that is replaced after two of three batches, so that there are two segments."""
    header = Header(msgspec.structs.replace(INFO, sensors=SENSORS), "")
    record_messages(directory, header, batch(0), batch(1))
    record_messages(directory, header, batch(2, last=True))


def verdict(directory: Path) -> Verification:
    return verify(read_session(directory))


@pytest.mark.parametrize("table", ["slow", "sensors"])
@pytest.mark.parametrize(("segment", "missing"), [(1, 2), (2, 1)])
def test_rows_of_a_file_that_was_removed_are_missing(
    tmp_path: Path, table: str, segment: int, missing: int
) -> None:
    record_in_two_parts(tmp_path)
    assert verdict(tmp_path).whole
    (tmp_path / f"{table}-{segment:04}.parquet").unlink()
    assert verdict(tmp_path).problems == (f"{missing} of 3 rows of the table {table} are missing",)


@pytest.mark.parametrize(
    ("dropped", "problems"),
    [
        (Dropped(slow=2), ("2 slow steps were not recorded",)),
        (Dropped(events=3), ("3 events were not recorded",)),
        (
            Dropped(ticks=4, slow=5, events=6),
            ("5 slow steps were not recorded", "6 events were not recorded"),
        ),
    ],
)
def test_what_the_recorder_counted_as_lost_is_named_by_its_kind(
    tmp_path: Path, dropped: Dropped, problems: tuple[str, ...]
) -> None:
    record_in_two_parts(tmp_path)
    write_info(tmp_path, msgspec.structs.replace(read_info(tmp_path), dropped=dropped))
    found = verdict(tmp_path)
    assert not found.whole
    assert (found.missing_ticks, found.problems) == (dropped.ticks, problems)


@pytest.mark.parametrize("table", ["ticks", "slow", "sensors"])
def test_a_copy_in_the_place_of_another_segment_hides_nothing(tmp_path: Path, table: str) -> None:
    header = Header(msgspec.structs.replace(INFO, sensors=SENSORS), "")
    for number in range(3):
        record_messages(tmp_path, header, batch(number, last=number == 2))
    assert verdict(tmp_path).whole
    shutil.copy(tmp_path / f"{table}-0001.parquet", tmp_path / f"{table}-0002.parquet")
    assert f"{table}-0002.parquet: its rows are not later than those before them" in (
        verdict(tmp_path).problems
    )
