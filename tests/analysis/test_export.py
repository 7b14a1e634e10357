"""Each export is opened by the program that it is for."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pytest
from asammdf import MDF
from mcap.reader import make_reader
from scipy.io import loadmat

from adaptdrive.analysis.export import export
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.session import TICKS
from tests.recording.material import INFO

NAME = "20261121T012209Z_motor"


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


def test_parquet_opens_in_polars(session_path: Path, output: list[float], tmp_path: Path) -> None:
    ticks, _ = export(session_path, "parquet", tmp_path)
    assert pl.read_parquet(ticks)["output"].to_list() == output


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
            for _, _, message in reader.iter_messages(topics=[f"/motor/{TICKS}"])
        ]
    assert [value for _, value in found] == output
    assert datetime.fromtimestamp(found[0][0] * 1e-9, UTC) == INFO.started
