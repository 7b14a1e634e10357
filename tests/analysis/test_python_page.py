"""The examples of docs/python.md and docs/walk.md, run in their order."""

from __future__ import annotations

import asyncio
import re
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import polars as pl
import pytest

from adaptdrive.config.services import Mqtt
from adaptdrive.errors import RefusedError
from adaptdrive.lab import Drive, load_session
from adaptdrive.recording.reader import read_session
from tests.app.test_replay import EXAMPLE
from tests.operation.peers import load_report, serving
from tests.support import Broker

DOCS = Path(__file__).parents[2] / "docs"


def examples(page: str = "python.md") -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def test_the_examples_on_sessions_run(
    session_path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "session").symlink_to(session_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for code in examples()[:4]:
        exec(code, names)
    said = capsys.readouterr().out
    assert "motor orderly" in said
    assert re.search(r"gain 0\.01\d+ ± .*adaptive", said)
    assert re.search(r"tau_s': '80\.8 .*dead time 0", said, re.DOTALL)
    assert re.search(r"gain = 0\.01\d+ ± .*on-line 0\.01", said)


def test_the_walk_through_a_session_runs(
    session_path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "session").symlink_to(session_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict[str, Any] = {}
    for code in examples("walk.md"):
        exec(code, names)
    names["plt"].close(names["figure"])
    said = capsys.readouterr().out
    assert "missing: 0 ticks" in said
    assert "30.0 s  trip   stale: 54 ms" in said
    assert re.search(r"error: median 0\.\d+ V", said)
    assert re.search(r"gain: 0\.01\d+ ± .*on-line 0\.01", said)
    assert (tmp_path / "walk.png").stat().st_size > 10_000


def test_the_example_with_a_plant_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("motor.toml", "adaptdrive.dbc"):
        shutil.copy(EXAMPLE.with_name(name), tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(examples()[4], names)
    assert "adaptive" in capsys.readouterr().out
    first = names["run"]
    exec(examples()[5], names)
    settled = names["run"].ticks.filter(pl.col("time_s") > 60.0)["output"].to_list()
    assert settled == pytest.approx([2.5] * len(settled), abs=0.01)
    held = first.ticks.filter(pl.col("time_s").is_between(410.0, 419.0))
    assert held["output"].to_list() == pytest.approx([2.4] * held.height, abs=0.01)


async def test_the_example_on_a_running_drive_runs(mosquitto: Broker, tmp_path: Path) -> None:
    names: dict[str, Any] = {}
    exec(examples()[6], names)
    broker = Mqtt(host=mosquitto.host, port=mosquitto.port)
    async with serving(mosquitto, "motor", tmp_path) as bench, asyncio.TaskGroup() as group:
        stepping = group.create_task(names["step"](broker))
        while not stepping.done():
            bench.hub.publish(load_report(7))
            await asyncio.sleep(0.05)
        assert isinstance(stepping.result(), float)
        with pytest.raises(RefusedError, match="outside"):
            await Drive("motor", broker).set_setpoint(9.0)


def test_pandas_holds_the_same(session_path: Path) -> None:
    tables = load_session(session_path, "pandas")
    assert isinstance(tables.ticks, pd.DataFrame)
    recorded = read_session(session_path).ticks["output"].to_pylist()
    assert tables.ticks["output"].tolist() == recorded
    assert tables.units["output"] == "V"
    assert tables.events["detail"].tolist() == ["stale: 54 ms"]
