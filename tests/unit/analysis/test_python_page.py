"""The examples of docs/python.md and docs/walk.md, run in their order."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from tests.unit.app.test_replay import EXAMPLE

DOCS = Path(__file__).parents[3] / "docs"


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
    for code in examples()[2:7]:
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


@pytest.mark.proof
def test_the_example_with_a_plant_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("motor.toml", "adaptdrive.dbc"):
        shutil.copy(EXAMPLE.with_name(name), tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(examples()[7], names)
    assert "adaptive" in capsys.readouterr().out
    first = names["run"]
    exec(examples()[8], names)
    settled = names["run"].ticks.filter(pl.col("time_s") > 60.0)["output"].to_list()
    assert settled == pytest.approx([2.5] * len(settled), abs=0.01)
    held = first.ticks.filter(pl.col("time_s").is_between(410.0, 419.0))
    assert held["output"].to_list() == pytest.approx([2.4] * held.height, abs=0.01)
