"""Where the commands on a session write: bad arguments, odd names, a disk that is full."""

from __future__ import annotations

import json
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from adaptdrive.cli import main
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import create_session
from tests.unit.app.test_replay import EXAMPLE, PRIOR, lived
from tests.unit.recording.material import INFO, make_batch, record_messages

COMPUTATIONS = {
    "plot": "adaptdrive.analysis.figures.draw_session",
    "identify": "adaptdrive.analysis.record.identify_any",
    "whatif": "adaptdrive.analysis.record.identify_any",
}
FORMS = ["csv", "parquet", "mat", "mdf4", "mcap"]
ROOM = 1000
"""Bytes that a file may have: less than any of the results."""

NAME = os.fsdecode(b"adaptdrive-\xff")
"""A name that is no UTF-8, which the kernel takes all the same."""


@pytest.mark.parametrize(
    ("words", "error"),
    [
        *(
            (f"{command} SESSION --into INTO/occupied/figures", "Not a directory")
            for command in COMPUTATIONS
        ),
        ("whatif SESSION --into INTO --set load.pole=2", "load."),
        ("whatif SESSION --into INTO --set load.pole", "load."),
        ("whatif SESSION --into INTO --set load.type=bath", "load."),
    ],
)
def test_arguments_are_judged_before_anything_is_computed(
    session_path: Path,
    tmp_path: Path,
    words: str,
    error: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def compute(*_: object, **__: object) -> None:
        raise AssertionError("computed with arguments that are not valid")

    (tmp_path / "occupied").touch()
    command = words.replace("SESSION", str(session_path)).replace("INTO", str(tmp_path))
    with pytest.MonkeyPatch.context() as patch:
        for place in COMPUTATIONS.values():
            patch.setattr(place, compute)
        assert main(command.split()) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert error in errors


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session that was copied to a folder with a name that is no UTF-8."""
    folder, text = tmp_path_factory.mktemp("state"), EXAMPLE.read_text(encoding="utf-8")
    directory = create_session(folder, INFO, text)
    record_messages(directory, Header(INFO, text), make_batch(*lived(PRIOR, 20), last=True))
    return directory.rename(folder / NAME)


def test_a_session_of_any_name_is_read_exported_and_drawn(
    recorded: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for command in ("show", "verify"):
        assert main(["sessions", command, str(recorded), "--json"]) == 0
        assert json.loads(capfd.readouterr().out)
    folder = tmp_path / NAME
    for form in FORMS:
        assert main(["export", str(recorded), "--to", form, "--into", str(folder / form)]) == 0
        assert all(path.stat().st_size for path in (folder / form).iterdir())
    assert main(["plot", str(recorded), "--into", str(folder)]) == 0
    assert "adaptdrive-\\udcff" in (folder / "report.html").read_text(encoding="utf-8")


@contextmanager
def full_disk() -> Iterator[None]:
    """Refuse all of a file that lies behind its first bytes, as a full disk does."""
    free, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with pytest.MonkeyPatch.context() as patch:
        # cache no module that a command imports: Python would keep its first bytes as a whole
        patch.setattr(sys, "dont_write_bytecode", True)
        resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (free, hard))


def refused(words: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    """Run a command that cannot write its files; return its one line."""
    with full_disk():
        status = main(words)
    errors = capfd.readouterr().err
    assert (status, errors.count("\n")) == (1, 1)
    return errors


@pytest.mark.parametrize("form", FORMS)
def test_an_export_is_whole_or_as_before(
    session_path: Path, tmp_path: Path, form: str, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["export", str(session_path), "--to", form, "--into", str(tmp_path)]
    assert str(tmp_path) in refused(words, capfd)
    assert not list(tmp_path.iterdir())
    assert main(words) == 0
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert before
    capfd.readouterr()
    refused(words, capfd)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(("command", "result"), [("plot", "figure.png"), ("identify", "load.png")])
def test_a_figure_is_whole_or_not_there(
    session_path: Path, tmp_path: Path, command: str, result: str, capfd: pytest.CaptureFixture[str]
) -> None:
    line = refused([command, str(session_path), "--into", str(tmp_path)], capfd)
    assert str(tmp_path / result) in line
    assert not list(tmp_path.iterdir())
