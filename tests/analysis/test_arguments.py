"""Arguments of the commands on a session are judged before anything is computed."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.cli import main

COMPUTATIONS = {
    "plot": "adaptdrive.analysis.plot.draw_session",
    "identify": "adaptdrive.analysis.record_load.identify_any",
    "whatif": "adaptdrive.analysis.record_load.identify_any",
}


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no computation begin."""

    def compute(*_: object, **__: object) -> None:
        raise AssertionError("computed with arguments that are not valid")

    for place in COMPUTATIONS.values():
        monkeypatch.setattr(place, compute)


@pytest.mark.usefixtures("refused")
@pytest.mark.parametrize("command", COMPUTATIONS)
def test_a_folder_that_takes_no_file_is_refused_at_once(
    session_path: Path, tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    occupied = tmp_path / "occupied"
    occupied.touch()
    folder = occupied / "figures"
    assert main([command, str(session_path), "--into", str(folder)]) == 2
    error = f"adaptdrive: --into: {folder}: cannot be written: Not a directory\n"
    assert capsys.readouterr() == ("", error)


@pytest.mark.usefixtures("refused")
@pytest.mark.parametrize("setting", ["load.pole=2", "load.pole", "load.type=bath"])
def test_a_setting_that_is_not_valid_is_refused_at_once(
    session_path: Path, tmp_path: Path, setting: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["whatif", str(session_path), "--set", setting, "--into", str(tmp_path)]
    assert main(words) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert "load." in errors


def test_a_missing_folder_is_made(session_path: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "figures"
    assert main(["plot", str(session_path), "--into", str(folder)]) == 0
    assert (folder / "report.html").is_file()
