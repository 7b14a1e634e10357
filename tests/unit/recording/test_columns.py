"""Files that explain themselves: what another program finds about each column, without this one."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import pyarrow as pa
import pytest
from pyarrow import parquet as pq

from adaptdrive.app.recording import sensor_columns
from adaptdrive.config import load_configuration
from adaptdrive.recording.records import CommandRow, Header, sensor_row
from adaptdrive.recording.session import create_session
from adaptdrive.recording.tables import INPUT_UNIT
from adaptdrive.runtime.reports import SensorReport, SensorSample
from tests.unit.mqtt.peers import drive_report, load_report
from tests.unit.recording.material import INFO, make_batch, make_tick, record_messages

BATH = Path(__file__).parents[3] / "deploy" / "examples" / "bath-thermocouples.toml"
UTC_OFFSET_S = INFO.started.timestamp() - 50.0
SI = {"", "s", "V", "A", "W", "K", "S", "Hz", "µs", INPUT_UNIT}
COMMAND = CommandRow(INFO.started, 50.0, "op-7", "setpoint", "3.1", "ann@bench", True, "", 1)
READ = {"bath_temperature": 310.25, "inflow_temperature": 288.5}
AGE_S = {"bath_temperature": 0.125, "inflow_temperature": 0.25}

SAMPLE = SensorSample(
    50.51,
    {"thermocouples.bath_temperature": 310.5},
    {"thermocouples.bath_temperature": 0.0625},
)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of one tick, one slow step, one reading of the sensors and one command."""
    columns = sensor_columns(load_configuration(BATH))
    info = msgspec.structs.replace(INFO, output_unit="K", sensors=columns)
    report = replace(
        drive_report(1),
        sensors=(SensorReport("thermocouples", True, "", READ, AGE_S, {}),),
        time_s=50.5,
    )
    batch = msgspec.structs.replace(
        make_batch([make_tick(0)], [replace(load_report(1), time_s=50.0)], last=True),
        utc_offset_s=UTC_OFFSET_S,
        sensors=[sensor_row(report), sensor_row(SAMPLE)],
        commands=[COMMAND],
    )
    directory = create_session(tmp_path_factory.mktemp("sessions"), info, "")
    record_messages(directory, Header(info, ""), batch)
    return directory


def about(field: pa.Field) -> dict[str, str]:
    return {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}


@pytest.mark.parametrize("table", ["ticks", "slow", "sensors"])
def test_each_column_has_its_unit_meaning_and_source(files: Path, table: str) -> None:
    schema = pq.read_schema(files / f"{table}-0001.parquet")
    assert {"utc", "monotonic_s"} <= set(schema.names)
    for field in schema:
        found = about(field)
        assert set(found) >= {"unit", "description", "source"}, field.name
        assert found["description"], field.name
        assert found["source"], field.name
        assert found["unit"] in SI, field.name


def test_each_value_of_a_sensor_bus_is_recorded_with_its_age(files: Path) -> None:
    table = pq.read_table(files / "sensors-0001.parquet")
    row, sample = table.to_pylist()
    assert sample["monotonic_s"] == SAMPLE.time_s
    assert sample["thermocouples.bath_temperature"] == 310.5
    assert sample["thermocouples.bath_temperature.age_s"] == 0.0625
    for name, value in READ.items():
        field = table.schema.field(f"thermocouples.{name}")
        assert row[field.name] == value
        assert row[f"{field.name}.age_s"] == AGE_S[name]
        assert about(field)["unit"] == "K"
        assert about(field)["source"] == "sensor bus thermocouples"
        assert about(table.schema.field(f"{field.name}.age_s"))["unit"] == "s"
    assert row["monotonic_s"] == 50.5
    assert row["utc"] == datetime.fromtimestamp(50.5 + UTC_OFFSET_S, UTC)


def test_a_command_is_recorded_with_its_id_and_its_sender(files: Path) -> None:
    (row,) = pq.read_table(files / "commands-0001.parquet").to_pylist()
    assert (row["id"], row["verb"], row["value"]) == ("op-7", "setpoint", "3.1")
    assert (row["user"], row["accepted"], row["reason"]) == ("ann@bench", True, "")
    assert row["time"] == INFO.started
