"""Sessions that version 0.1.0 recorded are still read and replayed."""

import math
import shutil
from pathlib import Path

import pytest

from adaptdrive.recording.reader import read_session
from adaptdrive.recording.repair import close_lost, close_segments
from adaptdrive.recording.replay import replay
from adaptdrive.recording.session import Ending
from tests.recording.test_replay import MISSED_HALF_CYCLES, StandIn

FORMAT1 = Path(__file__).with_name("format1")
TICKS = 599 - len(MISSED_HALF_CYCLES)


@pytest.mark.parametrize("name", ["closed", "open"])
def test_an_older_session_replays_bit_equal(name: str) -> None:
    session = read_session(FORMAT1 / name)
    report = replay(session, StandIn())
    assert report.exact
    assert report.ticks == TICKS
    assert not report.differing_decisions


def test_what_an_older_session_lacks_is_unknown() -> None:
    session = read_session(FORMAT1 / "closed")
    assert session.info.format == 1
    assert session.ticks["utc"].null_count == TICKS
    assert session.ticks["output"].null_count == 0
    assert all(map(math.isnan, session.ticks["monotonic_s"].to_pylist()))
    assert all(map(math.isnan, session.slow["pole_in_force"].to_pylist()))
    assert session.slow.num_rows > 0
    assert session.sensors.num_rows == 0
    assert [event.detail for event in session.events] == ["over-voltage: 431 V"]
    assert session.commands == ()


def test_an_older_session_that_was_lost_is_closed(tmp_path: Path) -> None:
    directory = Path(shutil.copytree(FORMAT1 / "open", tmp_path / "session"))
    info = close_lost(directory)
    close_segments(directory)
    assert info is not None
    assert info.ended is Ending.LOST
    assert sum(info.histograms["lateness_us"]) == TICKS
    names = {path.name for path in directory.iterdir()}
    assert {"ticks.parquet", "slow.parquet"} < names
    assert replay(read_session(directory), StandIn()).exact
