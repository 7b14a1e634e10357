"""Each export is opened by the program that it is for."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest
from asammdf import MDF
from mcap.reader import make_reader
from scipy.io import loadmat

from adaptdrive.analysis.export import export
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import SensorColumn, TableName, create_session
from tests.unit.mqtt.peers import load_report
from tests.unit.recording.material import INFO, make_batch, make_tick, record_messages

UTC_OFFSET_S = INFO.started.timestamp() - 50.0


@pytest.fixture(scope="module")
def output(session_path: Path) -> list[float]:
    table = read_session(session_path).ticks
    return [float(value) for value in table["output"].to_pylist()]


def test_csv_opens_in_pandas(session_path: Path, output: list[float], tmp_path: Path) -> None:
    ticks, slow = export(session_path, "csv", tmp_path)
    read = pd.read_csv(ticks, parse_dates=["utc"])
    assert read["output"].tolist() == output
    assert read["utc"][0].to_pydatetime() == INFO.started
    estimates = pd.read_csv(slow)
    assert np.isfinite(estimates["estimate_gain"]).all()
    assert {"gains_0", "estimate_gain_std"} <= set(estimates.columns)


def test_mat_opens_in_scipy(session_path: Path, output: list[float], tmp_path: Path) -> None:
    (path,) = export(session_path, "mat", tmp_path)
    read = loadmat(path, simplify_cells=True)
    assert read["ticks"]["output"].tolist() == output
    assert read["ticks_units"]["boost_voltage_V"] == "V"
    assert read["ticks_units"]["output"] == "V"


def test_mdf4_opens_in_asammdf(session_path: Path, output: list[float], tmp_path: Path) -> None:
    (path,) = export(session_path, "mdf4", tmp_path)
    with MDF(path) as file:
        assert file.start_time.astimezone(UTC) == INFO.started
        voltage = file.get("boost_voltage_V")
        group, index = file.whereis("output")[0]
        read = file.get(group=group, index=index)
    assert read.samples.tolist() == output
    assert voltage.unit == "V"
    assert read.timestamps[120] == pytest.approx(1.0)


def test_mcap_opens_in_its_reader(session_path: Path, output: list[float], tmp_path: Path) -> None:
    (path,) = export(session_path, "mcap", tmp_path)
    with path.open("rb") as stream:
        reader = make_reader(stream)
        found = [
            (message.log_time, json.loads(message.data)["output"])
            for _, _, message in reader.iter_messages(topics=[f"/motor/{TableName.TICKS}"])
        ]
    assert [value for _, value in found] == output
    assert datetime.fromtimestamp(found[0][0] * 1e-9, UTC) == INFO.started


SENSORS = ("2nd.inflow", "_x.inflow", "2nd-inflow", "a" * 64 + ".water", "a" * 64 + ".air")


@pytest.fixture
def sensed_path(tmp_path: Path) -> Path:
    """A session with sensors, whose first slow step comes 20 s after its first tick."""
    columns = tuple(SensorColumn(name, "K", "temperature", "sensor bus") for name in SENSORS)
    info = msgspec.structs.replace(INFO, sensors=columns)
    directory = create_session(tmp_path / "sessions", info, "")
    step = replace(load_report(1), time_s=70.0)
    batch = msgspec.structs.replace(
        make_batch([make_tick(0), make_tick(1)], [step], last=True),
        sensors=[{"monotonic_s": 60.0} | dict.fromkeys(SENSORS, 288.5)],
        utc_offset_s=UTC_OFFSET_S,
    )
    record_messages(directory, Header(info, ""), batch)
    return directory


def test_tables_have_one_time_in_mdf4(sensed_path: Path, tmp_path: Path) -> None:
    (path,) = export(sensed_path, "mdf4", tmp_path / "files")
    with MDF(path) as file:
        assert file.start_time.astimezone(UTC) == INFO.started
        begins = {name: file.get(name).timestamps[0] for name in ("applied_k", "gains_0")}
        assert file.get("2nd.inflow").timestamps[0] == pytest.approx(10.0)
    assert begins == {"applied_k": 0.0, "gains_0": pytest.approx(20.0)}


def test_names_that_matlab_does_not_accept_are_replaced(sensed_path: Path, tmp_path: Path) -> None:
    (path,) = export(sensed_path, "mat", tmp_path / "files")
    read = loadmat(path, simplify_cells=True)
    fields = set(read["sensors"]) - {"utc", "monotonic_s"}
    assert {read["sensors_names"][field] for field in fields} == set(SENSORS)
    assert all(re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,62}", field) for field in fields)
    assert all(read["sensors"][field] == 288.5 for field in fields)
    assert "ticks_names" not in read
