"""Overviews of sessions: no extreme is lost, and the index follows the folder."""

from __future__ import annotations

import math
import random
import shutil
from datetime import timedelta
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.recording.overview import (
    INDEX_FILE,
    MOST_POINTS,
    OVERVIEW_FILE,
    Column,
    Curves,
    Entry,
    Overview,
    refresh,
    thinned,
    update_index,
)
from adaptdrive.recording.records import CommandRow, EventRow, Header, Keep
from adaptdrive.recording.segments import prune
from adaptdrive.recording.session import Ending, create_session, read_info
from tests.unit.recording.material import (
    INFO,
    archive_all,
    make_batch,
    make_tick,
    record_messages,
    write_log,
)

VALUES = st.none() | st.floats(allow_infinity=False)


def known(values: list[float | None]) -> list[float]:
    return [one for one in values if one is not None and not math.isnan(one)]


@given(values=st.lists(VALUES, max_size=60), group=st.sampled_from([2, 4, 8, 64]))
def test_each_group_keeps_its_least_and_its_most_in_their_order(
    values: list[float | None], group: int
) -> None:
    found = thinned(values, group)
    for place, at in enumerate(range(0, len(values), group)):
        part, pair = known(values[at : at + group]), found[2 * place : 2 * place + 2]
        if not part:
            assert pair == [None, None]
            continue
        first, second = known(pair)
        assert (min(first, second), max(first, second)) == (min(part), max(part))
        assert part.index(first) <= part.index(second)
    assert len(found) == 2 * math.ceil(len(values) / group)


@pytest.mark.parametrize("seed", range(4))
def test_curves_of_any_length_keep_the_extremes_in_few_points(seed: int) -> None:
    """Rows come in parts of any size; NumPy finds the extremes of all of them."""
    chance, curves, every = random.Random(seed), Curves(), list[float]()
    while len(every) < 3_000 * 4**seed:
        part = [chance.gauss(0.0, 1.0) for _ in range(chance.randrange(1, 9_000))]
        part = [math.nan if chance.random() < 0.1 else one for one in part]
        times_s = [0.008 * (len(every) + place) for place in range(len(part))]
        curves.take(times_s, {"output": Column("V", [*part])})
        every += part
    values = known(curves.columns["output"].values)
    assert min(values) == pytest.approx(np.nanmin(every), rel=1e-6)
    assert max(values) == pytest.approx(np.nanmax(every), rel=1e-6)
    assert len(curves.time_s) == len(curves.columns["output"].values) <= MOST_POINTS
    assert curves.time_s == sorted(curves.time_s)
    assert (curves.time_s[0], curves.time_s[-1]) == (0.0, round(0.008 * (len(every) - 1), 4))
    assert len(every) > MOST_POINTS or curves.rows_per_point == 1


def event(number: int, kind: str, monotonic_s: float, trip_kind: str | None = None) -> EventRow:
    severity = "alarm" if trip_kind else "info"
    time = INFO.started + timedelta(seconds=monotonic_s - 50.0)
    words = f"number {number}"
    return EventRow(time, number, kind, severity, words, monotonic_s, number, trip_kind)


def recorded(sessions: Path, segments: int = 3, age_days: float = 0.0, ticks: int = 3_000) -> Path:
    """A session whose segments have ticks, an event and a command each."""
    info = msgspec.structs.replace(INFO, started=INFO.started - timedelta(days=age_days))
    directory = create_session(sessions, info, "")
    for part in range(segments):
        batch = make_batch([make_tick(part * ticks + one) for one in range(ticks)])
        at_s = 50.0 + part * ticks / 120
        command = CommandRow(INFO.started, at_s, "1", "setpoint", "3.2", "ann", True, "", 2)
        notes = {"events": [event(1, "mode", at_s + 1.0)], "commands": [command]}
        record_messages(directory, Header(info, ""), msgspec.structs.replace(batch, **notes))
    return directory


def overview(directory: Path) -> Overview:
    return msgspec.json.decode((directory / OVERVIEW_FILE).read_bytes(), type=Overview)


def index(sessions: Path) -> dict[str, Entry]:
    entries = msgspec.json.decode((sessions / INDEX_FILE).read_bytes(), type=list[Entry])
    return {one.name: one for one in entries}


def test_segment_by_segment_gives_the_overview_that_all_at_once_gives(tmp_path: Path) -> None:
    whole = recorded(tmp_path / "whole")
    refresh(whole, read_info(whole))
    grown = create_session(tmp_path / "grown", INFO, "")
    for file in whole.glob("*.parquet"):
        shutil.copy(file, grown)
    for part in (1, 2, 3):  # one that is not closed may be there, and half-written
        refresh(grown, msgspec.structs.replace(read_info(whole), segments=part))
    assert overview(grown) == overview(whole)
    found = overview(whole)
    assert found.zero_s == 50.0
    assert found.tables["ticks"].rows_per_point == 2
    assert found.tables["ticks"].columns["load_power_W"].unit == "W"
    assert [note.time_s for note in found.notes] == [0.0, 1.0, 25.0, 26.0, 50.0, 51.0]
    assert found.notes[0].detail == "setpoint 3.2 by ann"
    assert found.files.keys() == {file.name for file in whole.glob("*.parquet")}


def test_a_torn_segment_is_named_and_the_others_are_shown(tmp_path: Path) -> None:
    directory = recorded(tmp_path)
    torn = directory / "ticks-0002.parquet"
    torn.write_bytes(torn.read_bytes()[:-100])
    found = refresh(directory, read_info(directory))
    assert len(found.damage) == 1
    assert found.damage[0].startswith("ticks-0002.parquet: ")
    assert found.tables["ticks"].time_s[-1] == pytest.approx(75.0, abs=0.01)
    assert len(found.notes) == 6


@pytest.mark.parametrize("content", [b"", b"[]", b'{"drive": 1}', b"\xff"])
def test_a_damaged_overview_or_index_is_made_again(tmp_path: Path, content: bytes) -> None:
    directory = recorded(tmp_path)
    update_index(tmp_path)
    paths = directory / OVERVIEW_FILE, tmp_path / INDEX_FILE
    before = [path.read_bytes() for path in paths]
    for path in paths:
        path.write_bytes(content)
    update_index(tmp_path, {directory.name})
    assert [path.read_bytes() for path in paths] == before


def test_a_removed_session_leaves_the_index(tmp_path: Path) -> None:
    old, young = recorded(tmp_path, 1, age_days=9.0), recorded(tmp_path, 1, age_days=2.0)
    update_index(tmp_path)
    assert list(index(tmp_path)) == [old.name, young.name]
    assert len(list(prune(tmp_path, Keep(days=7.0), INFO.started))) == 1
    update_index(tmp_path)
    assert list(index(tmp_path)) == [young.name]


def test_a_session_that_cannot_be_read_hides_no_other(tmp_path: Path) -> None:
    lost, kept = recorded(tmp_path, 1, age_days=1.0), recorded(tmp_path, 1)
    (lost / "session.json").write_text("{", encoding="utf-8")
    update_index(tmp_path)
    assert list(index(tmp_path)) == [kept.name]


def test_the_archiver_lists_a_session_with_the_record_of_its_trip(tmp_path: Path) -> None:
    header = Header(msgspec.structs.replace(INFO, log="../motor.log"), "", sessions="sessions")
    session = create_session(tmp_path / "sessions", header.info, "")
    batch = make_batch([make_tick(one) for one in range(12_000)], last=True)
    notes = [event(1, "trip", 120.0, "over-voltage"), event(2, "latency", 121.0)]
    write_log(tmp_path / "motor.log", header, msgspec.structs.replace(batch, events=notes))
    assert archive_all(tmp_path / "motor.log") == []
    entry = index(tmp_path / "sessions")[session.name]
    assert (entry.drive, entry.started, entry.ended) == ("motor", INFO.started, Ending.ORDERLY)
    (trip,) = entry.trips
    assert (trip.time, trip.text) == (notes[0].time, "number 1")
    record = overview(session / trip.record)
    assert [(note.kind, note.time_s) for note in record.notes] == [("trip", 60.0)]
    assert overview(session).notes[0].trip_kind == "over-voltage"
