import math
import os
import struct
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import parquet as pq

from adaptdrive.analysis.replay import recorded_ticks
from adaptdrive.control.signals import (
    Command,
    Decision,
    Estimate,
    Measurement,
    Mode,
    Order,
    Snapshot,
    Stage,
)
from adaptdrive.recording.reader import read_session, session_notes
from adaptdrive.recording.records import CommandRow, EventRow, Header, note_row
from adaptdrive.recording.session import Dropped, Ending
from adaptdrive.runtime.reports import Event, LoadReport, Severity, TickReport
from adaptdrive.util.errors import RecordingError
from tests.unit.recording.material import INFO, make_batch, make_tick, record_messages

FLOATS = st.floats(allow_subnormal=True) | st.sampled_from([0.0, -0.0, 5e-324, -5e-324])
INTS = st.integers(-(2**63), 2**63 - 1)
MODES = st.sampled_from(Mode)
ORDERS = st.builds(Order, st.sampled_from(Stage), FLOATS, MODES, FLOATS, FLOATS)
TICKS = st.builds(
    TickReport,
    sequence=INTS,
    measurement=st.builds(
        Measurement, INTS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, fresh=st.booleans()
    ),
    order=ORDERS,
    applied_k=INTS,
    command=st.builds(Command, FLOATS, FLOATS, st.booleans()),
    lateness_us=FLOATS,
    turnaround_us=FLOATS,
)
CHAINS = st.lists(FLOATS, max_size=4).map(tuple)
# Arrow stores text as UTF-8, which has no lone surrogates.
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=10)
SLOW = st.builds(
    LoadReport,
    snapshot=st.builds(
        Snapshot, INTS, INTS, FLOATS, ORDERS, FLOATS, CHAINS, CHAINS, FLOATS, st.booleans(), INTS
    ),
    decision=st.builds(
        Decision,
        k=INTS,
        boost_reference_V=FLOATS,
        controller=MODES,
        accepted=st.booleans(),
        reason=TEXTS,
        estimates=st.dictionaries(TEXTS, st.builds(Estimate, FLOATS, FLOATS), max_size=3),
        gains=CHAINS,
        innovation=FLOATS,
        excitation=FLOATS,
        handover_step_V=FLOATS,
    ),
)


def bits(value: Any) -> Any:
    """A value with each float replaced by its bytes."""
    if isinstance(value, float):
        return struct.pack("<d", value)
    if isinstance(value, dict):
        return {name: bits(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [bits(item) for item in value]
    return value


def values(tick: TickReport) -> Any:
    measurement, order, command = tick.measurement, tick.order, tick.command
    return bits(
        [
            tick.sequence,
            tick.applied_k,
            *[getattr(measurement, name) for name in Measurement.__slots__],
            *[getattr(order, name) for name in Order.__slots__],
            *[getattr(command, name) for name in Command.__slots__],
        ]
    )


@settings(max_examples=20, suppress_health_check=[HealthCheck.too_slow])
@given(ticks=st.lists(TICKS, min_size=1, max_size=8), split=st.integers(0, 8))
def test_ticks_come_back_to_the_last_bit(ticks: list[TickReport], split: int) -> None:
    batches = [make_batch(ticks[:split]), make_batch(ticks[split:], last=True)]
    with tempfile.TemporaryDirectory() as name:
        record_messages(Path(name), Header(INFO, "x = 1\n"), *batches)
        session = read_session(Path(name))
        recorded = [values(tick) for tick in recorded_ticks(session)]
        assert session.ticks.num_rows == len(ticks)
    assert recorded == list(map(values, ticks))
    lateness = session.ticks["lateness_us"].to_pylist()
    assert bits(lateness) == bits([tick.lateness_us for tick in ticks])
    turnaround = session.ticks["turnaround_us"].to_pylist()
    assert bits(turnaround) == bits([tick.turnaround_us for tick in ticks])
    counted = session.info.histograms["turnaround_us"]
    assert sum(counted) == sum(not math.isnan(time_us) for time_us in turnaround)


@settings(max_examples=20, suppress_health_check=[HealthCheck.too_slow])
@given(slow=st.lists(SLOW, min_size=1, max_size=5))
def test_slow_steps_come_back_to_the_last_bit(slow: list[LoadReport]) -> None:
    with tempfile.TemporaryDirectory() as name:
        record_messages(Path(name), Header(INFO, ""), make_batch([], slow, last=True))
        rows = read_session(Path(name)).table("slow").to_pylist()
    for row, report in zip(rows, slow, strict=True):
        snapshot, decision = report.snapshot, report.decision
        assert row["k"] == snapshot.k
        assert row["tick"] == snapshot.tick
        assert row["held_ticks"] == snapshot.held_ticks
        assert row["followed"] == snapshot.followed
        assert bits(row["reference"]) == bits(snapshot.order.reference)
        for name in ("period_s", "output", "output_filtered", "input_filtered", "applied_V"):
            assert bits(row[name]) == bits(getattr(snapshot, name))
        for name in ("controller", "accepted", "reason"):
            assert row[name] == getattr(decision, name)
        for name in ("boost_reference_V", "gains", "innovation", "excitation", "handover_step_V"):
            assert bits(row[name]) == bits(getattr(decision, name))
        estimates = {e["name"]: (e["value"], e["std"]) for e in row["estimates"]}
        expected = {name: (e.value, e.std) for name, e in decision.estimates.items()}
        assert bits(estimates) == bits(expected)


def test_whole_numbers_where_floats_belong_are_recorded_as_floats(tmp_path: Path) -> None:
    order = Order(Stage.RUN, 3, Mode.FIXED, 0.7)
    tick = TickReport(0, Measurement(0, 1, 2, 3, 4, 5), order, -1, Command(0, 0, False), 0, 0)
    record_messages(tmp_path, Header(INFO, ""), make_batch([tick]))
    assert read_session(tmp_path).ticks["reference"].to_pylist() == [3.0]


def test_events_configuration_and_losses_come_back(tmp_path: Path) -> None:
    now = datetime(2026, 1, 2, 3, 4, 5, 678901, tzinfo=UTC)
    event = EventRow(now, 7, "trip", "alarm", "hot", 12.5, 1)
    command = CommandRow(now, 12.25, "op-1", "setpoint", "3.1", "ann", False, "too fast", 2)
    dropped = Dropped(ticks=5)
    last = msgspec.structs.replace(
        make_batch([], last=True), events=[event], dropped=dropped, commands=[command]
    )
    record_messages(tmp_path, Header(INFO, "[drive]\nname = 'µ'\n"), last)
    session = read_session(tmp_path)
    assert session.events == (event,)
    assert session.commands == (command,)
    assert session.config_text == "[drive]\nname = 'µ'\n"
    assert session.info.dropped == Dropped(ticks=5)
    assert session.info.ended is Ending.ORDERLY


def test_a_damaged_parquet_file_is_an_error_that_names_it(tmp_path: Path) -> None:
    record_messages(tmp_path, Header(INFO, ""), make_batch([make_tick(0)], last=True))
    (tmp_path / "ticks-0001.parquet").write_bytes(b"PAR1 but not really")
    with pytest.raises(RecordingError, match=r"ticks-0001\.parquet"):
        _ = read_session(tmp_path).ticks


@pytest.mark.parametrize("names", [["sequence"], ["sequence", "sequence"]])
def test_a_damaged_column_is_an_error_that_names_its_file(tmp_path: Path, names: list[str]) -> None:
    record_messages(tmp_path, Header(INFO, ""), make_batch([make_tick(0)], last=True))
    columns = [pa.array([{"a": 1}], pa.struct([("a", pa.int64())]))] * len(names)
    pq.write_table(pa.Table.from_arrays(columns, names), tmp_path / "ticks-0001.parquet")
    with pytest.raises(RecordingError, match=r"ticks-0001\.parquet: a column is damaged"):
        _ = read_session(tmp_path).ticks


def test_an_event_that_names_a_file_whose_name_is_no_utf_8_is_recorded(tmp_path: Path) -> None:
    event = Event("journal", Severity.WARNING, os.fsdecode(b"st\xff/motor: damaged"), -1)
    row = note_row(event, INFO.started, 1.0, 1)
    batch = msgspec.structs.replace(make_batch([], last=True), events=[row])
    record_messages(tmp_path, Header(INFO, ""), batch)
    assert read_session(tmp_path).events[0].detail == r"st\udcff/motor: damaged"


@pytest.mark.parametrize(
    "damage",
    [{"time": "noon"}, {"detail": b"\xad"}, {"tick": "many"}, {"kind": None}, {"number": math.nan}],
)
def test_a_damaged_event_is_an_error_that_names_its_log(
    tmp_path: Path, damage: dict[str, Any]
) -> None:
    event = EventRow(INFO.started, 7, "trip", "error", "stale", 1.0, 1)
    batch = msgspec.structs.replace(make_batch([], last=True), events=[event])
    record_messages(tmp_path, Header(INFO, ""), batch)
    assert read_session(tmp_path).events[0].detail == "stale"
    path = tmp_path / "events-0001.parquet"
    (row,) = pq.read_table(path).to_pylist()
    pq.write_table(pa.Table.from_pylist([row | damage]), path)
    assert "events-0001.parquet: " in read_session(tmp_path).damage
    with pytest.raises(RecordingError, match=r"events-0001\.parquet"):
        session_notes(tmp_path)
