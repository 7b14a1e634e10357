"""A session whose event log is damaged: its ticks are used, and the damage is named."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import parquet as pq

from adaptdrive.cli import analysis
from adaptdrive.cli.analysis import SessionView
from adaptdrive.cli.sessions import events, replay, show, verify
from adaptdrive.lab import load_session
from adaptdrive.recording.reader import read_session
from adaptdrive.util.errors import RecordingError
from tests.support import sample

LOG = "events-0001.parquet"


def _garbage(path: Path) -> None:
    path.write_bytes(b"no table at all" * 100)


def _spoilt_page(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[4:204] = b"\xff" * 200
    path.write_bytes(content)


def _spoilt_row(path: Path) -> None:
    rows = pq.read_table(path).to_pylist()
    pq.write_table(pa.Table.from_pylist([row | {"time": "no time"} for row in rows]), path)


@pytest.fixture(params=sample([_garbage, _spoilt_row, _spoilt_page], 2))
def damaged(request: pytest.FixtureRequest, session_path: Path, tmp_path: Path) -> Path:
    damage: Callable[[Path], None] = request.param
    path = tmp_path / session_path.name
    shutil.copytree(session_path, path)
    damage(path / LOG)
    return path


def test_its_ticks_are_drawn_and_exported(
    damaged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    into = damaged.parent / "out"
    into.mkdir()
    work: list[Callable[[], int]] = [
        lambda: analysis.plot(str(damaged), view=SessionView(into=into)),
        lambda: analysis.export(str(damaged), to="csv", into=into),
        lambda: show(str(damaged)),
    ]
    for one in work:
        assert one() == 0
        assert str(damaged / LOG) in capsys.readouterr().err
    assert LOG in (into / "report.html").read_text(encoding="utf-8")
    exported = (into / f"{damaged.name}_ticks.csv").read_text(encoding="utf-8")
    assert exported.count("\n") == read_session(damaged).ticks.num_rows + 1


def test_its_replay_is_that_of_the_sound_session(
    damaged: Path, session_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, sound = replay(str(session_path)), capsys.readouterr()
    assert replay(str(damaged)) == status
    again = capsys.readouterr()
    assert "replayed 6000 ticks" in again.out
    assert again.out == sound.out
    assert str(damaged / LOG) in again.err
    assert not sound.err


def test_its_tables_come_with_a_warning(damaged: Path) -> None:
    with pytest.warns(UserWarning, match=r"events-0001\.parquet"):
        tables = load_session(damaged)
    assert len(tables.ticks) == read_session(damaged).ticks.num_rows
    assert len(tables.events) == 0


def test_its_events_themselves_are_an_error(
    damaged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(RecordingError, match=r"events-0001\.parquet"):
        events(str(damaged))
    if damaged.joinpath(LOG).read_bytes().startswith(b"no table"):
        assert verify(str(damaged)) == 1
        assert LOG in capsys.readouterr().err
