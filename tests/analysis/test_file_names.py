"""Names of files that are no UTF-8, which the kernel takes all the same."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from adaptdrive.cli import main
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import create_session
from tests.app.test_replay import EXAMPLE, PRIOR, lived
from tests.recording.material import INFO, make_batch, record_messages

NAME = os.fsdecode(b"adaptdrive-\xff")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session that was copied to a folder with such a name."""
    folder, text = tmp_path_factory.mktemp("state"), EXAMPLE.read_text(encoding="utf-8")
    directory = create_session(folder, INFO, text)
    record_messages(directory, Header(INFO, text), make_batch(*lived(PRIOR, 20), last=True))
    return directory.rename(folder / NAME)


@pytest.mark.parametrize("command", ["show", "verify"])
def test_a_session_is_read(
    recorded: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sessions", command, str(recorded), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("form", ["csv", "parquet", "mat", "mdf4", "mcap"])
def test_a_session_is_exported(recorded: Path, tmp_path: Path, form: str) -> None:
    folder = tmp_path / NAME
    assert main(["export", str(recorded), "--to", form, "--into", str(folder)]) == 0
    assert all(path.stat().st_size for path in folder.iterdir())


def test_a_session_is_drawn(recorded: Path, tmp_path: Path) -> None:
    assert main(["plot", str(recorded), "--into", str(tmp_path / NAME)]) == 0
    assert "adaptdrive-\\udcff" in (tmp_path / NAME / "report.html").read_text(encoding="utf-8")
